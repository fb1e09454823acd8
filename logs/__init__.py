"""The cell's memory: one MCAP a cycle, read back, compared, and shown."""
