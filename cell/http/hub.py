"""Passes on what the cell says to every open stream; a stream that takes too little ends, and delays nobody."""

from __future__ import annotations

import asyncio
from typing import NamedTuple

from bus.errors import Refused

KEPT = 256
"""Messages that wait for one stream; a browser that misses more connects again, and is told the present state."""
FIRST_SAID = ("state", "health", "jobs", "picture", "scene")
"""Of these a new stream hears the last one at its begin."""


class Said(NamedTuple):
    """One message to the streams: its name, and its JSON on one line."""

    name: str
    data: str


class Listening:
    """One stream's end of the hub."""

    def __init__(self) -> None:
        self._queue: asyncio.Queue[Said | None] = asyncio.Queue(KEPT)

    def put(self, said: Said | None) -> None:
        """Queue a message; None ends the stream, and so does one that no longer fits."""
        if self._queue.full():
            while not self._queue.empty():
                self._queue.get_nowait()
            said = None
        self._queue.put_nowait(said)

    async def next(self) -> Said | None:
        """Return the next message; None at the end of the stream."""
        return await self._queue.get()


class Hub:
    """All open streams. Its members are called on the loop's thread only.

    Args:
        most: streams at a time.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._open: set[Listening] = set()
        self._last: dict[str, Said] = {}
        self._is_closed = False

    @property
    def is_listened_to(self) -> bool:
        """Whether any stream is open."""
        return bool(self._open)

    def last(self, name: str) -> str:
        """Return the JSON of the last message of that name; "" without one."""
        return self._last[name].data if name in self._last else ""

    def join(self) -> Listening:
        """A new stream, told what counts now. Raises: Refused (TOO_MANY)."""
        if len(self._open) >= self._most:
            raise Refused(
                f"There are {self._most} open streams already.",
                "Close some, or raise http.most_streams.",
                code="TOO_MANY",
            )
        listening = Listening()
        for name in FIRST_SAID:
            if name in self._last:
                listening.put(self._last[name])
        self._open.add(listening)
        if self._is_closed:
            listening.put(None)
        return listening

    def leave(self, listening: Listening) -> None:
        """End a stream's part; idempotent."""
        self._open.discard(listening)

    def tell(self, name: str, data: str) -> None:
        """Pass a message on to every stream."""
        said = Said(name, data)
        if name in FIRST_SAID:
            self._last[name] = said
        for listening in self._open:
            listening.put(said)

    def close(self) -> None:
        """End all streams, and every later one at once."""
        self._is_closed = True
        for listening in self._open:
            listening.put(None)
