"""Detectors of other packages: what one is given and gives, where it is found, and what is asked of its grasps."""
