"""Faults of a cell's doors: a client that attends a pick through one is killed, or the door itself, frozen, kept out.

The clients are the examples of the documentation, in processes of their own.
"""

from __future__ import annotations

import queue
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from bus import topics
from bus.free_port import free_port
from bus.session import Bus
from cell.nodes import doors
from config.clock import clock_of
from config.schema import Station

_EXAMPLES = Path(__file__).resolve().parents[1] / "docs" / "examples"
_CLIENTS = {"http": "http_client.py", "opcua": "opcua_client.py"}
_PATIENCE_S = 120.0
_LOOK_S = 0.01


def door_settings() -> tuple[str, ...]:
    """Free ports for both doors, which they keep when they are started again."""
    return (f"http.port={free_port()}", f"opcua.endpoint=opc.tcp://127.0.0.1:{free_port()}/cell")


class DoorFaults:
    """The doors of a running cell, each opened when it is first needed, and the client of a pick.

    Args:
        station: has the ports of `door_settings`.
    """

    def __init__(self, station: Station) -> None:
        self._station = station
        self._ports = {"http": station.http.port, "opcua": int(station.opcua.endpoint.rpartition(":")[2].split("/")[0])}
        self._doors: dict[str, doors.Door] = {}
        self._children: dict[str, subprocess.Popen[str]] = {}
        self._news: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._client: subprocess.Popen[str] | None = None
        self._taker: socket.socket | None = None

    def pick(self, name: str) -> None:
        """Let a client pick through this door, and attend the motion."""
        if name not in self._doors:
            self._doors[name] = doors.Door(name, self._station, self._hear, self._spawn).start()
            assert self._await_open(), f"the door {name} does not open"
        where = f"http://127.0.0.1:{self._ports[name]}" if name == "http" else self._station.opcua.endpoint
        self._client = subprocess.Popen(
            [sys.executable, "-I", str(_EXAMPLES / _CLIENTS[name]), where],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,  # it tells of its end, which is our doing
            text=True,
        )

    def inject(self, name: str, word: str) -> None:
        """Spoil it; of what is killed, the lease is gone when this returns."""
        assert self._client is not None
        while not self._news.empty():
            self._news.get_nowait()
        victim = self._client if word == "client" else self._children[name]
        victim.send_signal(signal.SIGSTOP if word == "freeze" else signal.SIGKILL)
        if word == "taken":
            self._taker = self._take(name)
        if word != "freeze":
            with Bus.join(self._station.cell_id, self._station.bus.endpoint, clock=clock_of(self._station)) as bus:
                _wait(lambda: not any(one.startswith(f"{name}-") for one in bus.alive(topics.LEASE)))

    def heal(self, name: str, word: str) -> bool:
        """Give the port back, and wait until the door is open again by itself. False when it does not come."""
        if self._taker is not None:
            self._taker.close()
            self._taker = None
        self._end_client()
        return word == "client" or self._await_open()

    def close(self) -> None:
        """End client and doors."""
        self._end_client()
        for door in self._doors.values():
            door.close()

    def _spawn(self, name: str, station: Station) -> subprocess.Popen[str]:
        self._children[name] = child = doors.door_child(name, station)
        return child

    def _hear(self, code: str, _severity: str, _text: str, _advice: str) -> None:
        self._news.put(code)

    def _await_open(self) -> bool:
        try:
            while self._news.get(timeout=_PATIENCE_S) != "DOOR_OPEN":
                pass
        except queue.Empty:
            return False
        return True

    def _take(self, name: str) -> socket.socket:
        """Listen where the door did."""
        self._children[name].wait()
        while True:
            try:
                return socket.create_server(("127.0.0.1", self._ports[name]))
            except OSError:  # the kernel still closes its connections
                time.sleep(_LOOK_S)

    def _end_client(self) -> None:
        if self._client is not None:
            self._client.kill()
            self._client.wait()
            self._client = None


def _wait(is_so: Callable[[], bool]) -> None:
    give_up_s = time.monotonic() + _PATIENCE_S
    while not is_so() and time.monotonic() < give_up_s:
        time.sleep(_LOOK_S)
