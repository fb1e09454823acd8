"""One request to a provider, and what came back over the wire; what a client package makes of it counts for nothing.

The official packages build the request. Their reading of an answer is not asked for: a proxy's page, an empty body or
a field of another type ends in each of them as another exception.
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
"""Of one answer, unpacked: the largest picture in base64 takes a third of it."""
_MAX_REDIRECTS = 3
_PACKED = {"", "identity", "gzip", "x-gzip", "deflate"}
"""Packings whose unpacked size stays within sight of what came; each other one is refused."""

Connect = Callable[[Deadline], httpx2.BaseTransport]
"""A fresh connection's transport, on which nothing outlasts the deadline."""


@dataclass(frozen=True)
class Reply:
    """What came over the wire: status, headers with small letters, and the unpacked body."""

    status: int
    headers: dict[str, str]
    body: bytes


class Line:
    """A provider's line. ``client`` is for its package; what the package sends goes through `exchange`."""

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
        """What came back when ``ask`` sent its request through `client`. Raises: ModelFault when nothing whole did."""
        deadline = Deadline(timeout_s)
        transfer = _Transfer(self._connect(deadline), deadline)
        with transfer.under_way():
            try:
                ask()
            except Exception as error:  # noqa: BLE001 - any package's; where a whole answer came, it alone counts
                if transfer.reply is None:
                    raise _fault_of(error) from None  # its texts may hold the key
        if transfer.reply is None:
            raise ModelError(Code.MODEL_UNAVAILABLE, "It was not asked: the client package sent nothing.")
        return transfer.reply

    def close(self) -> None:
        self.client.close()


class _Transfer(httpx2.BaseTransport):
    """The requests of one exchange - more than one only by redirects - and the last one's answer."""

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
        """A redirect does not carry the key to somebody else, or out of TLS."""
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
    """Hands each request to the exchange that is under way on its thread."""

    def handle_request(self, request: httpx2.Request) -> httpx2.Response:
        return _current.get().handle_request(request)


def _fault_of(error: BaseException) -> ModelError:
    """What kept the answer from coming, whatever a package wrapped around it."""
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
