"""Stage 1 of the paper: choose the target, imagine the goal image, and check it against the observed one."""
