"""Self-contained HTML pages: of one cycle, and of a day."""
