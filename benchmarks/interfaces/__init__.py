"""The cell's interfaces to programs that do not speak its bus: how fast they accept, and miss a client."""
