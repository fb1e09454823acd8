"""Pixels, depths and points: pinhole model, registration, crops, the rod's line."""
