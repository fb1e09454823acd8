"""The HTTP interface of a real cell, in processes of its own: times to accept, to read, to tell, and to miss a client.

accept: of jobs that wait for their turn, as over the bus. reset, which takes the lease and opens a connection of its
own for it, and stop: until the cell's answer is there. read: of the state. told: from the POST of a reset until the
event stream says Resetting. lost: from the reset of the connection that attends a pick until the cell is Holding.
"""

from __future__ import annotations

import json
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import httpx2

from benchmarks.interfaces.spread import spread_ms
from bus.free_port import free_endpoint

_URL = re.compile(r"DOOR_OPEN .*(http://[\d.]+:\d+)")
_JSON = {"Content-Type": "application/json"}
_PATIENCE_S = 60.0


def measure(rounds: int = 200, losses: int = 10, pace: float = 1.0) -> dict[str, Any]:
    """Run a simulated cell with its HTTP interface, and measure.

    Args:
        rounds: resets, each with a stop right after it. ``losses``: picks whose client is lost.
        pace: simulated seconds a second.
    """
    with TemporaryDirectory() as folder, _served(Path(folder), pace) as url, ExitStack() as stack:
        http = stack.enter_context(httpx2.Client(base_url=url, headers=_JSON, timeout=_PATIENCE_S))
        events = _Events(url)
        stack.callback(events.close)
        times = [_round(http, events) for _ in range(rounds)]
        reads_s = [_timed(lambda: http.get("/api/state"))[0] for _ in range(rounds)]
        _make_ready(http)
        http.post("/api/commands/start", json={"cycles": rounds}, headers=events.session)
        jobs = accept_ms(http, events.session, rounds)
        http.post("/api/commands/stop")
        losses_s = [_loss(http, url) for _ in range(losses)]
    resets_s, stops_s, told_s = zip(*times, strict=True)
    figures = {"reset": resets_s, "stop": stops_s, "read": reads_s, "told": told_s, "lost": losses_s}
    return {"accept_ms": jobs, **{f"{name}_ms": spread_ms(of) for name, of in figures.items()}}


def accept_ms(http: httpx2.Client, session: dict[str, str], commands: int) -> dict[str, Any]:
    """The spread of the acceptance of so many jobs by a cell that works meanwhile; each is cancelled again.

    Args:
        session: the header of a session.

    Raises: RuntimeError when a job is refused.
    """
    took_s: list[float] = []
    for number in range(commands):
        job = {"job": {"job_id": f"measured-{number}", "queue": True}}
        a_job = partial(http.post, "/api/commands/pick", json=job, headers=session)
        took_s.append(_accepted(a_job))
        http.post("/api/commands/cancel", json=job)
    return spread_ms(took_s)


class _Events:
    """An open event stream with a session, which says that it runs; and when each state was heard."""

    def __init__(self, url: str) -> None:
        self._client = httpx2.Client(base_url=url, headers=_JSON, timeout=_PATIENCE_S)
        self._heard, self._is_there = threading.Condition(), threading.Event()
        self._states: list[tuple[float, str]] = []
        self.session: dict[str, str] = {}
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()
        self._is_there.wait(_PATIENCE_S)

    def _listen(self) -> None:
        try:
            with self._client.stream("GET", "/api/events", params={"client": "bench"}) as stream:
                name = ""
                for line in stream.iter_lines():
                    field, _, value = line.partition(": ")
                    name = value if field == "event" else name
                    if field == "data":
                        self._take(name, json.loads(value))
        except httpx2.HTTPError:
            return  # closed

    def _take(self, name: str, said: dict[str, Any]) -> None:
        if name == "session":
            self.session = {"X-Cell-Session": said["session"]}
            self._is_there.set()
        elif name == "ping":
            threading.Thread(target=self._beat, daemon=True).start()
        elif name == "state":
            with self._heard:
                self._states.append((time.perf_counter(), said["state"]))
                self._heard.notify_all()

    def _beat(self) -> None:
        headers = {**_JSON, **self.session}
        with suppress(httpx2.HTTPError):  # closed
            httpx2.post(f"{self._client.base_url}/api/heartbeat", headers=headers, timeout=_PATIENCE_S)

    def when(self, state: str, since_s: float) -> float:
        """The time of the first such state since then."""
        with self._heard:
            found: list[float] = []

            def is_heard() -> bool:
                found[:] = [when_s for when_s, name in self._states if name == state and when_s >= since_s]
                return bool(found)

            if not self._heard.wait_for(is_heard, _PATIENCE_S):
                raise TimeoutError(f"the stream did not say {state}, but {self._states[-8:]}")
            return found[0]

    def close(self) -> None:
        self._client.close()


def _round(http: httpx2.Client, events: _Events) -> tuple[float, float, float]:
    """Times [s] until a reset is accepted, a stop is, and the reset's state is told."""
    began_s = time.perf_counter()
    reset_s = _accepted(lambda: http.post("/api/commands/reset", headers=events.session))
    told_s = events.when("Resetting", began_s)
    stopping_s = time.perf_counter()
    stop_s = _accepted(lambda: http.post("/api/commands/stop"))
    events.when("Stopped", stopping_s)
    return reset_s, stop_s, told_s - began_s


def _loss(http: httpx2.Client, url: str) -> float:
    """Time [s] from the reset of an attending connection until the cell begins to hold."""
    _make_ready(http)
    host, port = url.removeprefix("http://").split(":")
    plug = socket.create_connection((host, int(port)))
    plug.sendall(f"POST /api/picks HTTP/1.1\r\nHost: {host}\r\nContent-Type: application/json\r\n\r\n".encode())
    _until(http, "stage", "execute")
    time.sleep(0.2)  # the arm is on its way
    plug.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    cut_ns = time.time_ns()
    plug.close()
    held = _until(http, "state", "Holding", "Held")
    http.post("/api/commands/stop")
    return float(held["since_ns"] - cut_ns) / 1e9


def _make_ready(http: httpx2.Client) -> None:
    """Reset a cell that stops, once the lease of the motion before is given back."""
    _until(http, "state", "Stopped")
    while http.post("/api/commands/reset?wait=true").status_code != 200:
        time.sleep(0.05)


def _until(http: httpx2.Client, field: str, *values: str) -> dict[str, Any]:
    give_up_s = time.monotonic() + _PATIENCE_S
    while (state := http.get("/api/state").json())[field] not in values:
        if time.monotonic() > give_up_s:
            raise TimeoutError(f"{field} is still {state[field]!r}")
        time.sleep(0.005)
    return dict(state)


def _timed(ask: Callable[[], httpx2.Response]) -> tuple[float, httpx2.Response]:
    began_s = time.perf_counter()
    answer = ask()
    return time.perf_counter() - began_s, answer


def _accepted(ask: Callable[[], httpx2.Response]) -> float:
    took_s, answer = _timed(ask)
    if answer.status_code != 200:
        raise RuntimeError(answer.text)
    return took_s


@contextmanager
def _served(folder: Path, pace: float) -> Iterator[str]:
    """A simulated cell that is up, and the URL of its interface."""
    settings = (f"bus.endpoint={free_endpoint()}", f"recording.folder={folder}", f"sim.pace={pace}", "http.port=0")
    options = [word for setting in settings for word in ("--set", setting)]
    cell = subprocess.Popen(
        [sys.executable, "-m", "cell", "start", "--http", "--no-report", *options], stdout=subprocess.PIPE, text=True
    )
    try:
        assert cell.stdout is not None
        found = next(filter(None, map(_URL.search, cell.stdout)))
        threading.Thread(target=cell.stdout.read, daemon=True).start()  # else it would wait for its reader
        yield found[1]
    finally:
        cell.terminate()
        cell.wait(_PATIENCE_S)


if __name__ == "__main__":
    print(json.dumps(measure(), indent=2))  # noqa: T201
