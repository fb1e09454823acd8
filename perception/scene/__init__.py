"""What was seen: the table, what stands on it, and what changed."""
