"""The time that a client of the cell waits from a command to its answer, over each protocol."""
