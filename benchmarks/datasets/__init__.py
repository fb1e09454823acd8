"""Labelled images of two grasp datasets, read from their original folders."""
