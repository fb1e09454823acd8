"""Finds a loopback endpoint for a cell that nobody else is meant to find."""

from __future__ import annotations

import socket


def free_endpoint() -> str:
    """A loopback endpoint that nobody listens on now; another program may take it before it is used."""
    return f"tcp/127.0.0.1:{free_port()}"


def free_port() -> int:
    """A TCP port of loopback, as `free_endpoint`."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
