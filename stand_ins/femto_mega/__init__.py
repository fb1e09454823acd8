"""A Femto Mega on loopback: a process that speaks the camera's own network protocol to the unmodified SDK.

It accepts what its author knew of that protocol: it proves the driver's logic against the SDK, not how cameras behave.
"""
