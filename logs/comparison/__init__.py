"""Compares recorded cycles, two by two or folder by folder."""
