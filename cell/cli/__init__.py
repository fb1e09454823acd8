"""The command line: a room for each kind of commands, and a module for each group of them."""
