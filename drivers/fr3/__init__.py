"""The Franka Research 3, driven at 1 kHz over its control interface (FCI) from a separate process."""
