"""A Femto Mega on loopback: a process that speaks the camera's own network protocol to the unmodified SDK.

It implements the known part of that protocol: it tests the driver's logic against the SDK, not the behaviour of
cameras.
"""
