"""Ranked grasps in ``base``, from aligned rods or from the height map; see docs/frames.md."""
