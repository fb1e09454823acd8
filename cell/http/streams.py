"""Answers that stay open: server-sent events, and JSON that is waited for. Each does something at its end, always."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable

from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

PING_S = 1.0
"""A stream is written to so often, so that a client that is gone is noticed, and one that is there can answer."""


class EndingStream(StreamingResponse):
    """A stream whose end is told, whoever ends it: its content, the client, the network or this process.

    Args:
        on_end: called once, on the loop's thread; it may not wait.
    """

    def __init__(self, content: AsyncIterator[bytes], media_type: str, on_end: Callable[[], None]) -> None:
        super().__init__(content, media_type=media_type)
        self._on_end = on_end

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the stream."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._on_end()


def event(name: str, data: str) -> bytes:
    """One server-sent event; ``data`` is JSON on one line."""
    return f"event: {name}\ndata: {data}\n\n".encode()
