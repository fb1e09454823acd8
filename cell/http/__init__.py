"""The cell over HTTP: commands and state as JSON, events as a stream, recordings and reports as files."""
