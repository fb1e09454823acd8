"""Pinhole geometry: lifting and projecting, registration, crops, the rod's line. Frames and units: docs/frames.md."""
