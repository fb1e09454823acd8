"""What a client of the cell waits for: from a command to its answer, over each protocol."""
