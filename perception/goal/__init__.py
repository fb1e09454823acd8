"""Stage 1 of the paper: which object is meant, the goal image, and what of it can be believed."""
