"""Commands about one station: its file, its plug-ins, its camera, its health."""
