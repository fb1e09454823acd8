"""A deadline for a whole transfer. An HTTP client's timeouts are per read, so a slow trickle of bytes never ends."""

from __future__ import annotations

import ssl
import time
from collections.abc import Callable, Iterable
from typing import Any

import httpcore2

_WRITE_BYTES = 1 << 16
"""Bytes per write: a server that accepts them slowly is given up between two writes."""


class Deadline:
    """A point in time ``timeout_s`` from now, on a monotonic clock."""

    def __init__(self, timeout_s: float, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        self._end_s = clock_s() + timeout_s

    @property
    def is_over(self) -> bool:
        """True when the time is over."""
        return self._clock_s() >= self._end_s

    def left(self) -> float:
        """Time left [s], more than 0. Raises: httpcore2.ReadTimeout when none is left."""
        left_s = self._end_s - self._clock_s()
        if left_s <= 0:
            raise httpcore2.ReadTimeout("the deadline of the whole call is over")
        return left_s


class DeadlineBackend(httpcore2.NetworkBackend):
    """Connections on which no operation - connect, handshake, read or write - outlasts ``deadline``."""

    def __init__(self, deadline: Deadline) -> None:
        self._deadline = deadline
        self._plain = httpcore2.SyncBackend()

    def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,
        local_address: str | None = None,
        socket_options: Iterable[httpcore2.SOCKET_OPTION] | None = None,
    ) -> httpcore2.NetworkStream:
        """Connect within the deadline [s]; ``timeout`` is ignored. Raises: httpcore2.ConnectTimeout."""
        left_s = self._deadline.left()
        return _Stream(self._plain.connect_tcp(host, port, left_s, local_address, socket_options), self._deadline)


class _Stream(httpcore2.NetworkStream):
    def __init__(self, stream: httpcore2.NetworkStream, deadline: Deadline) -> None:
        self._stream, self._deadline = stream, deadline

    def read(self, max_bytes: int, timeout: float | None = None) -> bytes:
        return self._stream.read(max_bytes, self._deadline.left())

    def write(self, buffer: bytes, timeout: float | None = None) -> None:
        for start in range(0, len(buffer), _WRITE_BYTES):
            self._stream.write(buffer[start : start + _WRITE_BYTES], self._deadline.left())

    def close(self) -> None:
        self._stream.close()

    def start_tls(
        self, ssl_context: ssl.SSLContext, server_hostname: str | None = None, timeout: float | None = None
    ) -> httpcore2.NetworkStream:
        return _Stream(self._stream.start_tls(ssl_context, server_hostname, self._deadline.left()), self._deadline)

    def get_extra_info(self, info: str) -> Any:
        return self._stream.get_extra_info(info)
