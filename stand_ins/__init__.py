"""Stands in for what tests and demos cannot have: hosted models that answer over HTTP."""
