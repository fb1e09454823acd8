"""The 2-D grasp rectangle: its metric, the formats of two datasets, and networks that predict it."""
