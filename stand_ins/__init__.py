"""Stand-ins for devices and hosted models that tests and demos cannot use."""
