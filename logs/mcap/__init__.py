"""One cycle in one MCAP file: written, read, listed, made whole, deleted by rule."""
