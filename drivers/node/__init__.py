"""A node: one process that serves devices on the bus, guarded, with their loops."""
