"""The Franka Panda hand."""
