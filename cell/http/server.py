"""Serves one door until its end: the server's loop, and what the cell says, each in a thread of its own."""

from __future__ import annotations

import asyncio
import errno
import logging
import os
import socket
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress

import uvicorn

from bus.clock import DeadlineClock
from bus.errors import BusError, ConfigError, PortOccupied
from bus.threads import OwnedThread, Role
from cell import client
from cell.client import Client
from cell.http.access import Access
from cell.http.app import application
from cell.http.door import ALSO, LOOK_S, REFRESH_S, Door
from cell.http.patience import PatientProtocol
from cell.nodes.loop_watch import LoopWatch, ended_by_defect
from config.clock import clock_of
from config.http import HttpSettings
from config.schema import Station

_GRACE_S = 2
_BACKLOG = 256


def serve(station: Station, tell: Callable[[str], None], wait_for_end: Callable[[], None]) -> None:
    """Serve the running cell over HTTP (`cell.nodes.door_child.Serve`).

    Raises: ConfigError, PortOccupied, CellUnreachable.
    """
    settings = station.http
    access = Access.of(settings, os.environ)
    logging.getLogger("uvicorn").setLevel(logging.ERROR)  # what clients send wrongly is no warning of ours

    def connect(client_id: str) -> AbstractContextManager[Client]:
        return client.connect(station, client_id=client_id)

    with (
        _listening(settings) as listener,
        client.connect(station, ALSO, client_id=client.client_name("http")) as cell,
        ended_by_defect(),
    ):
        clock = clock_of(station)
        door = Door(cell, connect, station, access, clock.now_s)
        serving = Serving(door, cell, listener, clock)
        serving.start()
        try:
            tell(address(settings, listener))
            wait_for_end()
        finally:
            serving.close()


class Serving:
    """The two threads of a door.

    Args:
        listener: a bound socket.
    """

    def __init__(self, door: Door, cell: Client, listener: socket.socket, clock: DeadlineClock) -> None:
        self._door, self._cell, self._listener, self._clock = door, cell, listener, clock
        self._server = uvicorn.Server(_config(door))
        self._loop: asyncio.AbstractEventLoop | None = None
        self._is_open, self._closing = threading.Event(), threading.Event()
        self._watch: LoopWatch | None = None
        self._threads = [
            OwnedThread(Role.DOOR, lambda: asyncio.run(self._serve()), of="http"),
            OwnedThread(Role.DOOR, self._hear, of="http-cell"),
        ]

    def start(self) -> None:
        """Begin to serve, and return when the first request would be answered."""
        for thread in self._threads:
            thread.start()
            self._is_open.wait()

    def close(self) -> None:
        """End all streams, answer what is asked, give every lease back. Idempotent."""
        self._closing.set()
        if self._loop is not None:
            with suppress(RuntimeError):  # the loop has ended already
                self._loop.call_soon_threadsafe(self._end)
        for thread in self._threads:
            thread.join()
        self._door.wait()

    def _end(self) -> None:
        if self._watch is not None:
            self._watch.close()
        self._door.close()
        self._server.should_exit = True

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        with suppress(BusError):
            self._door.greet(await self._door.ask(self._cell.state))
        self._watch = LoopWatch(self._clock, "http")
        regular = [asyncio.create_task(work) for work in (self._look(), self._refresh(), self._show())]
        self._is_open.set()
        try:
            await self._server.serve(sockets=[self._listener])
        finally:
            self._watch.close()
            for task in regular:
                task.cancel()

    async def _look(self) -> None:
        while True:
            self._door.look()
            await asyncio.sleep(LOOK_S)

    async def _refresh(self) -> None:
        while True:
            await asyncio.sleep(REFRESH_S)
            await self._door.refresh()

    async def _show(self) -> None:
        while (period_s := self._door.settings.picture_s) > 0:
            await asyncio.sleep(period_s)
            await self._door.show_live()

    def _hear(self) -> None:
        """Pass on what the cell says."""
        while not self._closing.is_set():
            sample = self._cell.next_heard(LOOK_S)
            if sample is not None and self._loop is not None:
                with suppress(RuntimeError):  # the loop has ended
                    self._loop.call_soon_threadsafe(self._door.hear, sample)


def _config(door: Door) -> uvicorn.Config:
    settings = door.settings
    return uvicorn.Config(
        application(door),
        http=PatientProtocol,
        ws="none",
        lifespan="off",
        log_config=None,
        access_log=False,
        proxy_headers=False,
        server_header=False,
        timeout_graceful_shutdown=_GRACE_S,
        ssl_certfile=settings.certificate,
        ssl_keyfile=settings.key,
    )


def _listening(settings: HttpSettings) -> socket.socket:
    """A socket that is bound; the server listens on it. Raises: PortOccupied, ConfigError."""
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    listener = socket.socket(family)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((settings.host, settings.port))
        listener.listen(_BACKLOG)
    except OSError as error:
        listener.close()
        where = f"{settings.host}:{settings.port}"
        if error.errno == errno.EADDRINUSE:
            raise PortOccupied(
                f"Another program listens on {where}.", "End it, or set http.port (0 = any free one)."
            ) from error
        raise ConfigError(f"Cannot listen on {where}: {error.strerror}.", "Set http.host and http.port.") from error
    return listener


def address(settings: HttpSettings, listener: socket.socket) -> str:
    """Return the interface's URL."""
    scheme = "https" if settings.certificate is not None else "http"
    host = f"[{settings.host}]" if ":" in settings.host else settings.host
    return f"{scheme}://{host}:{listener.getsockname()[1]}"
