"""The devices of the cell: three protocols, their drivers, and the node that serves them on the bus."""
