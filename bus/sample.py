"""A payload of the bus, a query's facts, and the callback types of those that receive, record or answer them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from bus.frozen import Message


class Sample(NamedTuple):
    """One payload that travelled.

    Attributes:
        key: below ``cell/{cell_id}/``.
        source: the session it came from (Zenoh's ZID); "" when it names none, or it is our own.
        is_sealed: the session in ``source`` holds our secret (`bus.seal`).
    """

    key: str
    encoding: str
    payload: bytes
    source: str = ""
    is_sealed: bool = False


class Asked(NamedTuple):
    """The facts about a query besides its payload.

    Attributes:
        verb: the last chunk of its key. ``is_exact``: the key is no pattern.
        encoding: of the payload. ``has_payload``: the payload is not empty.
        takes_any_key: the client accepts replies on other keys.
        source, number: the client's session and its number for this query; a repeated query has the same number.
        is_sealed: as in `Sample`.
        received_s: arrival time (monotonic).
    """

    verb: str
    is_exact: bool
    encoding: str
    has_payload: bool
    takes_any_key: bool
    source: str
    number: int
    is_sealed: bool
    received_s: float


Tap = Callable[[Sample], None]
Handler = Callable[[bytes, Asked], "Message | list[Sample]"]
"""Answers one query, given its payload and the facts about it."""
WorkerOf = Callable[[Asked, bytes], str]
"""Names the worker that a query waits for; called on Zenoh's thread, so it must not block."""
