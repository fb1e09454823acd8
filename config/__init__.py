"""The station's configuration: its schema, its limits, its files."""
