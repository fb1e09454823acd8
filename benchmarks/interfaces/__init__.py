"""How soon a command is accepted, and the state that it leads to seen, over each interface of a cell."""
