"""One request to a provider, and its raw reply. The client packages' parsing of replies is not used.

The official packages build the request. Their parsing fails on a proxy's page, an empty body or a field of another
type with a different exception in each package.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

import httpcore2
import httpx2

from bus.codes import Code
from bus.redaction import quoted
from perception.models.deadline import Deadline
from perception.models.errors import ModelError

_MAX_BYTES = 64 << 20
"""Limit of one answer, uncompressed; the largest picture in base64 takes a third of it."""
_MAX_REDIRECTS = 3
_PACKED = {"", "identity", "gzip", "x-gzip", "deflate"}
"""Accepted encodings, whose uncompressed size is bounded by the bytes received; others are refused."""

Connect = Callable[[Deadline], httpx2.BaseTransport]
"""Opens the transport of a fresh connection, on which no operation outlasts the deadline."""


@dataclass(frozen=True)
class Reply:
    """A reply as received.

    Attributes:
        status: HTTP status. ``headers``: names in lower case. ``body``: uncompressed bytes.
    """

    status: int
    headers: dict[str, str]
    body: bytes


class Line:
    """A connection to a provider. ``client`` is for the provider's package; its requests go through `exchange`."""

    def __init__(self, connect: Connect) -> None:
        self._connect = connect
        self.client = httpx2.Client(
            transport=_Switch(),
            follow_redirects=True,
            max_redirects=_MAX_REDIRECTS,
            headers={"Accept-Encoding": "gzip, deflate"},
            trust_env=False,
        )

    def exchange(self, timeout_s: float, ask: Callable[[], object]) -> Reply:
        """Send one request, which ``ask`` makes through `client`, within ``timeout_s``; return the raw reply.

        Raises: ModelError when no whole reply arrives.
        """
        deadline = Deadline(timeout_s)
        transfer = _Transfer(self._connect(deadline), deadline)
        with transfer.under_way():
            try:
                ask()
            except Exception as error:  # noqa: BLE001 - of any package; a whole reply counts even so
                if transfer.reply is None:
                    raise _fault_of(error) from None  # its texts may contain the key
        if transfer.reply is None:
            raise ModelError(Code.MODEL_UNAVAILABLE, "It was not asked: the client package sent nothing.")
        return transfer.reply

    def close(self) -> None:
        """Close the client."""
        self.client.close()


class _Transfer(httpx2.BaseTransport):
    """The requests of one exchange - several only after redirects - and the last reply."""

    def __init__(self, connection: httpx2.BaseTransport, deadline: Deadline) -> None:
        self._connection, self._deadline = connection, deadline
        self._asked: httpx2.URL | None = None
        self.reply: Reply | None = None

    @contextmanager
    def under_way(self) -> Iterator[None]:
        token = _current.set(self)
        try:
            yield
        finally:
            _current.reset(token)
            self._connection.close()

    def handle_request(self, request: httpx2.Request) -> httpx2.Response:
        self.reply = None
        self._require_same_server(request.url)
        answer = self._connection.handle_request(request)
        try:
            body = self._body(answer)
        finally:
            answer.close()
        self.reply = Reply(answer.status_code, dict(answer.headers), body)
        kept = [(name, value) for name, value in answer.headers.multi_items() if name not in _OF_TRANSFER]
        return httpx2.Response(answer.status_code, headers=kept, content=body)

    def _require_same_server(self, url: httpx2.URL) -> None:
        """Refuse redirects that would send the key to another host, or without TLS. Raises: ModelError."""
        first = self._asked = self._asked or url
        if url.host != first.host or (first.scheme == "https" and url.scheme != "https"):
            raise ModelError(Code.MODEL_UNAVAILABLE, f"It sends us on to {quoted(url.host)}: the key stays here.")

    def _body(self, answer: httpx2.Response) -> bytes:
        packed = answer.headers.get("content-encoding", "").strip().lower()
        if packed not in _PACKED:
            raise ModelError(Code.MODEL_UNAVAILABLE, f"It answered in a packing nobody asked for: {quoted(packed)}.")
        parts, size = [], 0
        for part in answer.iter_bytes():
            self._deadline.left()
            size += len(part)
            if size > _MAX_BYTES:
                raise ModelError(Code.MODEL_UNAVAILABLE, f"Its answer is larger than {_MAX_BYTES >> 20} MiB.")
            parts.append(part)
        return b"".join(parts)


_OF_TRANSFER = {"content-encoding", "content-length", "transfer-encoding"}
_current: ContextVar[_Transfer] = ContextVar("transfer")


class _Switch(httpx2.BaseTransport):
    """Passes each request to the exchange that is in progress on its thread."""

    def handle_request(self, request: httpx2.Request) -> httpx2.Response:
        return _current.get().handle_request(request)


def _fault_of(error: BaseException) -> ModelError:
    """The ModelError for an exception, found along its chain of causes."""
    chain = [error]
    while (cause := chain[-1].__cause__ or chain[-1].__context__) is not None and cause not in chain:
        chain.append(cause)
    for one in chain:
        if isinstance(one, ModelError):
            return one
        if isinstance(one, (httpcore2.TimeoutException, httpx2.TimeoutException)):
            return ModelError(Code.MODEL_TIMEOUT, "It did not answer in time.", again=True)
    root = quoted(str(chain[-1]) or type(chain[-1]).__name__)
    if any(isinstance(one, _TORN) for one in chain):
        return ModelError(Code.MODEL_UNAVAILABLE, f"Its answer could not be read ({root}).", again=True)
    if any(isinstance(one, _OF_NETWORK) for one in chain):
        return ModelError(Code.MODEL_UNAVAILABLE, f"It cannot be reached ({root}).", again=True)
    return ModelError(Code.MODEL_UNAVAILABLE, f"It could not be asked ({root}).")


_TORN = (httpx2.DecodingError, httpcore2.RemoteProtocolError, httpx2.RemoteProtocolError)
_OF_NETWORK = (httpcore2.NetworkError, httpcore2.ProxyError, httpx2.TransportError)
