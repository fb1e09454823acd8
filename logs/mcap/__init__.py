"""One cycle in one MCAP file: writing, reading, listing, recovery and deletion by rule."""
