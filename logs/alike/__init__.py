"""Finds cycles that are alike: the nearest to one, and groups of failures."""
