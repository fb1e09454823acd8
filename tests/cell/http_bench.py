"""The HTTP interface of a cell that answers as a test tells it: served for real, or asked without a server."""

from __future__ import annotations

import asyncio
import queue
import socket
import threading
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, cast

import httpx2

from bus.clock import WALL_CLOCK
from bus.commands import CellHealth, CellState, CommandReply, CommandRequest
from bus.errors import Refused
from bus.messages import CycleResult, LivePicture, PictureRequest, PlanView, Proposal
from bus.sample import Sample
from cell.client import Client
from cell.http.access import Access
from cell.http.app import application
from cell.http.door import Door
from cell.http.server import Serving, serve
from config.http import HttpSettings
from config.load import load_station
from config.schema import Station

IDLE = CellState(state="Idle", stage="", cycle_id="", since_ns=1, available=("pick",), reason="")
HEALTHY = CellHealth(is_healthy=True, nodes={})
ACCEPTED = CommandReply(ok=True, state="Starting", cycle_id="c1", job_id="c1")
RESULT = CycleResult(
    cycle_id="c1", object="cup", result="SUCCESS", code=None, reason="Held.", stages={}, wall_s=1.0, recording=""
)
EVERYBODY = Access({})


@dataclass
class FakeCell:
    """A cell that accepts everything, keeps what it was sent, and says what a test puts into ``said``."""

    client_id: str = "http-test"
    is_gone: bool = False
    refusal: Exception | None = None
    now: CellState = IDLE
    results: dict[str, CycleResult] = field(default_factory=dict)
    sent: list[tuple[str, CommandRequest]] = field(default_factory=list)
    said: queue.SimpleQueue[Sample] = field(default_factory=queue.SimpleQueue)
    live: LivePicture | None = None
    connected: list[str] = field(default_factory=list)

    def state(self) -> CellState:
        self._answer()
        return self.now

    def health(self) -> CellHealth:
        self._answer()
        return HEALTHY

    def send(self, verb: str, request: CommandRequest) -> CommandReply:
        self.sent.append((verb, request))
        self._answer()
        return ACCEPTED.model_copy(update={"since_ns": self.now.since_ns})

    def result(self, cycle_id: str) -> CycleResult | None:
        self._answer()
        return self.results.get(cycle_id)

    def proposal(self) -> Proposal:
        raise Refused("Nothing waits.", code="NO_PROPOSAL")

    def plan_view(self) -> PlanView:
        raise Refused("Nothing was planned.", code="NO_PLAN")

    def picture(self, _request: PictureRequest | None = None) -> LivePicture:
        if self.live is None:
            raise Refused("It works.", code="NOT_AT_REST")
        return self.live

    def next_heard(self, timeout_s: float) -> Sample | None:
        try:
            return self.said.get(timeout=timeout_s)
        except queue.Empty:
            return None

    @contextmanager
    def connect(self, client_id: str) -> Iterator[Client]:
        self.connected.append(client_id)
        yield cast(Client, self)
        self.connected.remove(client_id)

    def _answer(self) -> None:
        if self.refusal is not None:
            raise self.refusal


def door_of(
    cell: FakeCell, folder: Path, access: Access = EVERYBODY, settings: HttpSettings | None = None, **clock: Any
) -> Door:
    station = load_station(None, [f"recording.folder={folder}"])
    station = station.model_copy(update={"http": settings or HttpSettings()})
    return Door(cell, cell.connect, station, access, clock.get("now_s", WALL_CLOCK.now_s))


class Site(NamedTuple):
    """A served door, and a client of it."""

    cell: FakeCell
    door: Door
    port: int
    http: httpx2.Client

    def raw(self, request: bytes, timeout_s: float = 10.0) -> bytes:
        """The answer to bytes as they are, until the server closes or has answered."""
        with socket.create_connection(("127.0.0.1", self.port), timeout=timeout_s) as plug:
            plug.sendall(request)
            answer = b""
            while b"\r\n\r\n" not in answer and (part := plug.recv(65536)):
                answer += part
            return answer


@contextmanager
def served(door: Door, cell: FakeCell) -> Iterator[Site]:
    listener = socket.create_server(("127.0.0.1", 0))
    port = listener.getsockname()[1]
    with (
        closing(Serving(door, cast(Client, cell), listener, WALL_CLOCK)) as serving,
        httpx2.Client(base_url=f"http://127.0.0.1:{port}", timeout=30) as http,
    ):
        serving.start()
        yield Site(cell, door, port, http)


class Answer(NamedTuple):
    """The answer of an application."""

    status: int
    headers: dict[str, str]
    body: bytes


class Asked:
    """Asks an application without a server: one request after the other, on a loop of its own."""

    def __init__(self, door: Door) -> None:
        self._app, self._runner = application(door), asyncio.Runner()

    def close(self) -> None:
        self._runner.close()

    def __call__(
        self, method: str, path: str, body: bytes = b"", headers: Mapping[str, str] | None = None, query: str = ""
    ) -> Answer:
        given = {"host": "127.0.0.1", "content-type": "application/json", "content-length": str(len(body))}
        return self._runner.run(self._ask(method, path, body, given | dict(headers or {}), query))

    async def _ask(self, method: str, path: str, body: bytes, headers: dict[str, str], query: str) -> Answer:
        scope = {
            "type": "http", "asgi": {"version": "3.0", "spec_version": "2.3"}, "http_version": "1.1", "method": method,
            "scheme": "http", "path": path, "raw_path": path.encode(errors="replace"), "root_path": "",
            "query_string": query.encode(errors="replace"), "server": ("127.0.0.1", 80), "client": ("127.0.0.1", 9),
            "headers": [(name.lower().encode("latin-1", "replace"), value.encode("latin-1", "replace"))
                        for name, value in headers.items()],
        }  # fmt: skip
        given = [{"type": "http.request", "body": body, "more_body": False}]
        sent: list[Any] = []

        async def receive() -> Any:
            return given.pop() if given else {"type": "http.disconnect"}

        async def send(message: Any) -> None:
            sent.append(message)

        await self._app(scope, receive, send)
        start = next(message for message in sent if message["type"] == "http.response.start")
        found = {name.decode(): value.decode("latin-1") for name, value in start["headers"]}
        return Answer(start["status"], found, b"".join(message.get("body", b"") for message in sent))


def refused(code: str = "WRONG_STATE") -> Refused:
    return Refused("It is not possible now.", "Wait.", code=code, available=("stop",), state="Execute")


@contextmanager
def served_for_real(station: Station) -> Iterator[str]:
    """The HTTP interface of a running cell, as `cell http` serves it; gives its address."""
    where: queue.SimpleQueue[str] = queue.SimpleQueue()
    ended = threading.Event()
    here = station.model_copy(update={"http": HttpSettings(port=0)})
    thread = threading.Thread(target=serve, args=(here, where.put, ended.wait))
    thread.start()
    yield where.get(timeout=60)
    ended.set()
    thread.join(60)
