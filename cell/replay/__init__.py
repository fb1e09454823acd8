"""Reruns the pure stages of a recording, and compares."""
