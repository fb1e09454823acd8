"""HTML report pages: one per cycle, one per day."""
