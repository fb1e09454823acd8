"""The server's protocol with an end to patience: a connection without a whole head is closed, and so is a dead one."""

from __future__ import annotations

import asyncio
import socket
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

HEAD_S = 5.0
"""Longest time until the head of a request is there, from its first byte or from the connection on."""
UNACKNOWLEDGED_MS = 2000
"""A client whose machine acknowledges nothing for so long is gone: a cut cable, a machine that lost power."""


class PatientProtocol(H11Protocol):
    """HTTP/1.1 that waits for the head of a request for `HEAD_S`, not for ever."""

    _patience: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for the first head."""
        super().connection_made(transport)
        plug: Any = transport.get_extra_info("socket")
        if plug is not None:  # asyncio does so for some sockets only; without it an answer's body waits 40 ms
            plug.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if plug is not None and hasattr(socket, "TCP_USER_TIMEOUT"):
            plug.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNACKNOWLEDGED_MS)
        self._wait_for_head()

    def data_received(self, data: bytes) -> None:
        """Take bytes; while they make no whole head, the wait goes on, and is not begun anew."""
        super().data_received(data)
        if self.cycle is not None and not self.cycle.response_complete:
            self._stop_waiting()
        elif self._patience is None:
            self._wait_for_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop waiting."""
        self._stop_waiting()
        super().connection_lost(exc)

    def on_response_complete(self) -> None:
        """Leave the pause until the next request to the server's own time-out."""
        self._stop_waiting()
        super().on_response_complete()

    def _wait_for_head(self) -> None:
        self._patience = self.loop.call_later(HEAD_S, self.transport.close)

    def _stop_waiting(self) -> None:
        if self._patience is not None:
            self._patience.cancel()
            self._patience = None
