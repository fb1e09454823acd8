"""One pick: capture, detect, plan, execute, verify, and its record."""
