"""The cell's messages and their transport over Eclipse Zenoh. This package imports none of our others."""
