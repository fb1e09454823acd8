"""What programs of others may import: a cell's Python API, and the checks that a plug-in passes."""
