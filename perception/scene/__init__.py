"""The observed scene: the table, the objects on it, and its changes. Points are in ``base``; see docs/frames.md."""
