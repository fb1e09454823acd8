"""What this station is: its schema, its limits, its files."""
