"""Commands to a running cell: picks, states, motion by hand, and what it does now."""
