"""Runs the pure stages of a recording again, and compares."""
