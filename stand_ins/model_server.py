"""A loopback server with OpenAI's and Google's APIs, for the official clients, with injectable faults."""

from __future__ import annotations

import importlib
import json
import socket
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable
from enum import StrEnum
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import ModuleType, TracebackType
from typing import Annotated, Any, Literal

import cv2
import numpy as np
import numpy.typing as npt
import typer

from . import gemini_api, openai_api
from .asked import OF_PICTURES, BadRequest, Fault, Image, Kind, Mask, Picture, Reply, Request, encode
from .drift import NONE, Drift, apply, hard, mild
from .scenery import object_of

__all__ = ["Drift", "Fault", "Mask", "ModelServer", "Paint", "Picture", "Request", "Say", "default_text"]

Paint = Callable[[Picture], npt.NDArray[np.uint8]]
Say = Callable[[str, Image | None], str]
Drifts = Drift | Callable[[int], Drift]
"""One drift for every picture, or the drift of the n-th picture asked for."""


def default_text(prompt: str, image: Image | None) -> str:
    """Words when the caller has none."""
    return "Draw one straight rod through the middle of the object, across its narrowest part."


class ModelServer:
    """Answers as hosted models do; a context manager.

    Args:
        paint: draws the rod. ``drift``: what the model does to the picture besides.
        faults: one for each request of the kind ``faults_for``, in order; None = that request is fine. A fault that
            only a picture can have waits for a request for a picture.
        port: 0 = any free one.
        say: gives the words.
        retry_after_s: what a rate limit asks for.
    """

    def __init__(
        self,
        paint: Paint,
        *,
        drift: Drifts = NONE,
        faults: Iterable[Fault | None] = (),
        faults_for: Kind | Literal["any"] = "any",
        port: int = 0,
        say: Say = default_text,
        retry_after_s: int = 1,
    ) -> None:
        self.requests: list[Request] = []
        self._paint, self._say, self._drift = paint, say, drift
        self._faults, self._faults_for, self._retry_after_s = deque(faults), faults_for, retry_after_s
        self._lock = threading.Lock()
        self._http = _Server(("127.0.0.1", port), self)
        self.url = f"http://127.0.0.1:{self._http.server_address[1]}"
        self._thread = threading.Thread(target=self._http.serve_forever, args=(0.02,), name="model-server")

    def __enter__(self) -> ModelServer:
        self._thread.start()
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        if not self._thread.is_alive():
            return
        self._http.shutdown()
        self._thread.join()
        self._http.hang_up()
        self._http.server_close()

    def wait(self) -> None:
        """Serve until interrupted."""
        self._thread.join()

    def answer(self, api: ModuleType, path: str, headers: Any, body: bytes) -> Reply | None:
        """None = never."""
        try:
            request: Request = api.read(path, headers, body)
        except (BadRequest, ValueError, LookupError, TypeError, AttributeError) as error:
            return _of(api.rejected(400, str(error)))
        with self._lock:
            self.requests.append(request)
            number = sum(each.kind == "image" for each in self.requests) - 1
            fault = self._next_fault(request.kind)
        match fault:
            case Fault.HANG:
                return None
            case Fault.RATE_LIMIT | Fault.SERVER_ERROR | Fault.UNAUTHORIZED:
                return _of(api.failed(fault, self._retry_after_s))
            case Fault.REFUSAL:
                return _of(api.refused(request))
            case Fault.NO_CONTENT:
                return _of(api.empty(request))
        return self._fine(api, request, fault, number)

    def _next_fault(self, kind: Kind) -> Fault | None:
        if not self._faults or self._faults_for not in (kind, "any"):
            return None
        if kind == "text" and self._faults[0] in OF_PICTURES:
            return None
        return self._faults.popleft()

    def _fine(self, api: ModuleType, request: Request, fault: Fault | None, number: int) -> Reply:
        try:
            if request.kind == "text":
                return _of(api.said(request, self._say(request.prompt, request.image)))
            if fault == Fault.TEXT_ONLY:
                return _of(api.drawn(request, "I can describe the edited picture, but not draw it.", None))
            return _of(api.drawn(request, "Here is the edited picture.", self._picture(request, fault, number)))
        except Exception as error:  # noqa: BLE001 - the caller's painter; whatever it raises belongs into the answer
            return _of(api.rejected(500, f"The stand-in broke: {type(error).__name__}: {error}"))

    def _picture(self, request: Request, fault: Fault | None, number: int) -> bytes:
        assert request.image is not None, "an edit without a picture is refused before"
        painted = self._paint(Picture(request.image.copy(), request.mask, request.prompt))
        drift = self._drift if isinstance(self._drift, Drift) else self._drift(number)
        image = apply(request.image, painted, object_of(request.image, request.mask), drift)
        width, height = request.size or (image.shape[1], image.shape[0])
        if fault == Fault.WRONG_SIZE:
            height = max(1, height * 2 // 3)
        if (height, width) != image.shape[:2]:
            image = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)
        png = encode(image)
        return png[: len(png) // 2] if fault == Fault.TRUNCATED_PNG else png


def _of(reply: Any) -> Reply:
    assert isinstance(reply, Reply)
    return reply


class _Server(ThreadingHTTPServer):
    """Knows its connections, so that none outlives it."""

    daemon_threads = False
    request_queue_size = 64

    def __init__(self, address: tuple[str, int], models: ModelServer) -> None:
        super().__init__(address, _Handler)
        self.models = models
        self._open: set[socket.socket] = set()
        self._guard = threading.Lock()

    def process_request(self, request: Any, client_address: Any) -> None:
        with self._guard:
            self._open.add(request)
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        with self._guard:
            self._open.discard(request)
        super().shutdown_request(request)

    def hang_up(self) -> None:
        """End every connection; a client that reads from one gets its end."""
        with self._guard:
            for connection in self._open:
                try:
                    connection.shutdown(socket.SHUT_RDWR)
                except OSError:
                    continue

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that left is no error; a stand-in that breaks is."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    server: _Server

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        path = self.path.partition("?")[0]
        if gemini_api.PATH.fullmatch(path):
            reply = self.server.models.answer(gemini_api, path, self.headers, body)
        elif path in openai_api.PATHS:
            reply = self.server.models.answer(openai_api, path, self.headers, body)
        else:
            reply = openai_api.rejected(404, f"Invalid URL (POST {path})")
        if reply is None:
            self._hang()
        else:
            self._send(reply)

    def _hang(self) -> None:
        """Until the client leaves or the server ends."""
        self.close_connection = True
        while self.connection.recv(4096):
            pass

    def _send(self, reply: Reply) -> None:
        body = json.dumps(reply.body).encode()
        self.send_response(reply.status)
        for name, value in {"Content-Type": "application/json", "Content-Length": len(body), **reply.headers}.items():
            self.send_header(name, str(value))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: the requests are kept."""


class DriftLevel(StrEnum):
    """The degree to which the model follows."""

    NONE = "none"
    MILD = "mild"
    HARD = "hard"


def main(
    port: Annotated[int, typer.Option(help="Port on 127.0.0.1.")] = 8931,
    drift: Annotated[DriftLevel, typer.Option(help="What the model does to the picture besides.")] = DriftLevel.NONE,
    seed: Annotated[
        int, typer.Option(help="Seed of the first picture's drift; each further picture has the next.")
    ] = 1,
) -> None:
    """Serve until interrupted, painting with the painter beside this file."""
    painter = importlib.import_module(".painter", __package__)
    say: Say = getattr(painter, "say", default_text)
    draw = {DriftLevel.NONE: lambda _: NONE, DriftLevel.MILD: mild, DriftLevel.HARD: hard}[drift]
    with ModelServer(painter.paint, drift=lambda number: draw(seed + number), port=port, say=say) as server:
        typer.echo(f"OpenAI: {server.url}/v1   Gemini: {server.url}")
        try:
            server.wait()
        except KeyboardInterrupt:
            typer.echo("Stopped.")


if __name__ == "__main__":
    typer.run(main)
