"""The Orbbec Femto Mega, through Orbbec's own SDK."""
