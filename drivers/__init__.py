"""The devices of the cell: their protocols, their drivers, and the node that serves them on the bus."""
