"""Labelled images of two grasp datasets, as they lie in their own folders."""
