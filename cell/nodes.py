"""Runs driver nodes as child processes: crash isolation, because vendor SDKs segfault and hold the GIL.

The child gets its station as one JSON line on stdin, answers with one line on stdout when it serves (or why it cannot),
and ends when its stdin closes - so it never outlives the daemon, however that died.
"""

from __future__ import annotations

import json
import logging
import os
import selectors
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import IO

from pydantic import Field

from bus.codec import decode, encode
from bus.commands import ErrorReply
from bus.errors import BadPayload, CellError, DriverUnavailable
from bus.frozen import Message
from bus.remote_errors import error_from_reply, error_reply
from bus.session import Bus
from config.load import station_from
from config.schema import Station
from drivers.node import Node
from drivers.registry import open_devices

_log = logging.getLogger(__name__)
START_TIMEOUT_S = 60.0
_STOP_TIMEOUT_S = 5.0


class Ready(Message):
    """The child's first line: it serves, or why it cannot."""

    node: str
    pid: int = Field(ge=0)
    error: ErrorReply | None = None


class Supervisor:
    """The child processes of one daemon.

    Args:
        on_exit: called with (node name, exit code) from a watching thread when a child ends unasked.
    """

    def __init__(self, station: Station, on_exit: Callable[[str, int], None]) -> None:
        self._station = station
        self._on_exit = on_exit
        self._children: dict[str, subprocess.Popen[str]] = {}
        self._closing = False

    def start(self) -> None:
        """Start every node that runs here and wait until all serve. Raises: what the child could not do, typed."""
        for name, node in self._station.nodes.items():
            if node.run == "here":
                self._children[name] = self._spawn(name)
        for name, child in self._children.items():
            self._await_ready(name, child)
            threading.Thread(target=self._watch, args=(name, child), daemon=True).start()

    def close(self) -> None:
        """End all children: ask by closing their stdin, then insist; idempotent."""
        self._closing = True
        for child in self._children.values():
            if child.stdin is not None and not child.stdin.closed:
                child.stdin.close()
        for name, child in self._children.items():
            try:
                child.wait(_STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                _log.warning("node %s did not end by itself; killing it", name)
                child.kill()
                child.wait()
            if child.stdout is not None:
                child.stdout.close()

    def _spawn(self, name: str) -> subprocess.Popen[str]:
        child = subprocess.Popen(
            [sys.executable, "-m", "cell", "node", name, "--supervised"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C in the terminal is the daemon's to handle, in order
        )
        assert child.stdin is not None
        try:
            child.stdin.write(self._station.model_dump_json() + "\n")
            child.stdin.flush()
        except BrokenPipeError:
            _log.error("node %s ended before it read its station", name)
        return child

    def _await_ready(self, name: str, child: subprocess.Popen[str]) -> None:
        assert child.stdout is not None
        line = _line_within(child.stdout, START_TIMEOUT_S)
        try:
            ready = decode(Ready, line.encode())
        except BadPayload as error:
            self.close()
            raise DriverUnavailable(
                f"The node {name!r} did not start (exit code {child.poll()}).", "Its own message stands above."
            ) from error
        if ready.error is not None:
            self.close()
            raise error_from_reply(ready.error)

    def _watch(self, name: str, child: subprocess.Popen[str]) -> None:
        code = child.wait()
        if not self._closing:
            self._on_exit(name, code)


def _line_within(stream: IO[str], timeout_s: float) -> str:
    """The stream's next line, or "" after ``timeout_s`` or at its end."""
    with selectors.DefaultSelector() as selector:
        selector.register(stream, selectors.EVENT_READ)
        return stream.readline() if selector.select(timeout_s) else ""


def own_stdout() -> IO[str]:
    """This process's stdout for our own lines only: what vendors' libraries print there goes to stderr from now on."""
    ours = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    return ours


def serve_supervised(name: str, stdin: IO[str], stdout: IO[str]) -> int:
    """The child's side: read the station, serve node ``name``, end when stdin closes. Returns the exit code."""
    station = station_from(json.loads(stdin.readline()))
    try:
        with Bus.join(station.cell_id, station.bus.endpoint) as bus:
            node = Node(name, bus, open_devices(station.nodes[name].driver, station), station)
            node.open()
            _say(stdout, Ready(node=name, pid=os.getpid()))
            stdin.read()
            node.close()
    except CellError as error:
        _say(stdout, Ready(node=name, pid=os.getpid(), error=error_reply(error)))
        return error.exit_code
    return 0


def serve_until_interrupted(name: str, station: Station) -> None:
    """A node in a terminal of its own (``run = "elsewhere"``): serve until Ctrl-C."""
    with Bus.join(station.cell_id, station.bus.endpoint) as bus:
        node = Node(name, bus, open_devices(station.nodes[name].driver, station), station)
        node.open()
        try:
            while True:
                time.sleep(1.0)
        finally:
            node.close()


def _say(stdout: IO[str], ready: Ready) -> None:
    stdout.write(encode(ready).decode() + "\n")
    stdout.flush()
