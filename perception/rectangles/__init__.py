"""The 2-D grasp rectangle: its metric, and networks that predict it. In pixels; see docs/frames.md."""
