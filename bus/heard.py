"""What travels on the bus, as whoever hears, records or answers it gets it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from bus.frozen import Message


class Heard(NamedTuple):
    """One payload that travelled: ``key`` is below ``cell/{cell_id}/``."""

    key: str
    encoding: str
    payload: bytes


Tap = Callable[[Heard], None]
Handler = Callable[[bytes, Mapping[str, str]], "Message | list[Heard]"]
"""Answers one question, given its payload and the fields of its key."""
