"""From carried rods, or from the height map, to ranked grasps."""
