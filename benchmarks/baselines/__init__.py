"""Baselines of detection, for images without depth."""
