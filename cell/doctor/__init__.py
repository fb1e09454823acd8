"""``cell doctor``: what is missing on this machine, or around it, before a station is started for the first time."""
