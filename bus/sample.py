"""What travels on the bus, as whoever hears, records or answers it gets it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from bus.frozen import Message


class Sample(NamedTuple):
    """One payload that travelled.

    Attributes:
        key: below ``cell/{cell_id}/``.
        source: the session it came from, as Zenoh names it (its ZID); "" when it does not say, or it is our own.
        is_sealed: it really is from who it says, as far as we share a secret with it (`bus.seal`).
    """

    key: str
    encoding: str
    payload: bytes
    source: str = ""
    is_sealed: bool = False


class Asked(NamedTuple):
    """What is known of a question besides its payload.

    Attributes:
        verb: the last chunk of its key. ``is_exact``: the key is no pattern.
        encoding: of the payload. ``has_payload``: it brings one.
        takes_any_key: its asker accepts replies on other keys.
        source, number: the session that asks, and its number for this question; asked again, it has the same number.
        is_sealed: as in `Sample`.
        received_s: when it came (monotonic).
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
"""Answers one question, given its payload and what else is known of it."""
WorkerOf = Callable[[Asked, bytes], str]
"""In which lane a question waits; asked on Zenoh's thread, it may only look things up."""
