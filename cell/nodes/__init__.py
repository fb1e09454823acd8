"""The node processes: supervision, health and identity."""
