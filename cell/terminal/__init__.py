"""The terminal side of our processes: lines, tables, signals."""
