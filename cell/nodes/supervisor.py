"""Supervises driver nodes as child processes: vendor SDKs crash and hold the GIL, so each node is isolated.

The child gets its station as one JSON line on stdin, and in another line the secret that it shares with the cell. It
answers with one line on stdout when it serves (or why it cannot), and ends when its stdin closes, so it never outlives
the daemon.
"""

from __future__ import annotations

import io
import json
import logging
import os
import selectors
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from typing import IO

from pydantic import Field

from bus import topics
from bus.clock import DeadlineClock
from bus.codec import decode, encode
from bus.commands import ErrorReply
from bus.errors import BadPayload, CellError, DriverUnavailable
from bus.frozen import Message
from bus.remote_errors import error_from_reply, error_reply
from bus.seal import Seal
from bus.threads import OwnedThread, Role, handled_by
from cell.machine.leases import CELL_CLIENT
from cell.nodes.process import freeze_gc, limit_malloc_arenas
from cell.terminal.printing import log_plainly
from cell.terminal.signals import on_end
from config.clock import clock_of
from config.load import station_from
from config.schema import Station
from drivers.node.link import join_cell
from drivers.node.node import Node
from drivers.node.registry import open_devices

_log = logging.getLogger(__name__)
START_TIMEOUT_S = 60.0
_STOP_TIMEOUT_S = 5.0
_DEFECT_EXIT_CODE = 70
"""EX_SOFTWARE of sysexits.h."""
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.5, 30.0


class Ready(Message):
    """The child's first line: ready, or the error that prevents it."""

    node: str
    pid: int = Field(ge=0)
    error: ErrorReply | None = None


class Supervisor:
    """The child processes of one daemon; a child that ends unasked is restarted, with growing pauses.

    Args:
        on_exit: called with (node name, exit code) from a monitoring thread when a child ends unasked.
        on_back: called with the node's name when it serves again.
        seal: of the secret that the nodes receive.
        spawn: starts a node's process.
    """

    def __init__(
        self,
        station: Station,
        on_exit: Callable[[str, int], None],
        on_back: Callable[[str], None] = lambda name: None,
        seal: Seal | None = None,
        spawn: Callable[[str, Station], subprocess.Popen[str]] | None = None,
    ) -> None:
        self._station, self._start_child = station, spawn or partial(_child, seal=seal)
        self._clock = clock_of(station)
        self._on_exit, self._on_back = on_exit, on_back
        self._children: dict[str, subprocess.Popen[str]] = {}
        self._restarts: dict[str, int] = {}
        self._serving: set[str] = set()
        self._watchers: list[OwnedThread] = []
        self._closing = threading.Event()
        self._spawning = threading.Lock()  # no process is spawned once closing is set

    def start(self) -> None:
        """Start every node that runs here and wait until all serve. Raises: the typed error of a child that cannot."""
        for name, node in self._station.nodes.items():
            if node.run == "here":
                self._spawn(name)
        for name, child in self._children.items():
            _await_ready(name, child, self._clock)
            self._serving.add(name)
        for name in self._children:
            self._watchers.append(OwnedThread(Role.SUPERVISOR, partial(self._monitor, name), of=name).start())

    def close(self) -> None:
        """End all children: first by closing their stdin, then by force; idempotent."""
        with self._spawning:
            self._closing.set()
        for child in self._children.values():
            if child.stdin is not None and not child.stdin.closed:
                child.stdin.close()
        for name, child in self._children.items():
            if not self._clock.wait_for(partial(_has_ended, child), _STOP_TIMEOUT_S):
                _log.warning("node %s did not end by itself; killing it", name)
                child.kill()
                child.wait()
        for watcher in self._watchers:
            watcher.join(_STOP_TIMEOUT_S)
        for child in self._children.values():
            _close_pipes(child)

    def restarts(self, name: str) -> int:
        """Number of restarts of the node."""
        return self._restarts.get(name, 0)

    def end_frozen(self, name: str) -> None:
        """Kill a node that served, is silent and still runs; its monitoring thread restarts it.

        A node that is not a child, or is still starting, is left alone.
        """
        child = self._children.get(name)
        if child is not None and name in self._serving and child.poll() is None:
            _log.warning("node %s no longer answers; killing it", name)
            child.kill()

    def _spawn(self, name: str) -> bool:
        """Start the node's process; False when the supervisor is closing."""
        with self._spawning:
            if not self._closing.is_set():
                self._children[name] = self._start_child(name, self._station)
            return not self._closing.is_set()

    def _monitor(self, name: str) -> None:
        """Restart the node whenever it ends, until close."""
        while True:
            child = self._children[name]
            code = child.wait()
            self._serving.discard(name)
            if self._closing.is_set():
                return
            _close_pipes(child)
            self._on_exit(name, code)
            if not self._bring_back(name):
                return
            self._restarts[name] = self.restarts(name) + 1
            self._on_back(name)

    def _bring_back(self, name: str) -> bool:
        """Retry until the node serves; False when the supervisor closes first."""
        pause_s = _FIRST_PAUSE_S
        while not self._closing.wait(pause_s) and self._spawn(name):
            try:
                _await_ready(name, self._children[name], self._clock)
            except CellError as error:
                _log.warning("node %s cannot be brought back yet: %s", name, error)
                pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
            else:
                self._serving.add(name)
                return True
        return False


def _child(name: str, station: Station, seal: Seal | None = None) -> subprocess.Popen[str]:
    child = subprocess.Popen(
        [sys.executable, "-P", "-m", "cell.nodes.supervisor", name],  # -P: the working folder must not hide our modules
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        encoding="utf-8",  # independent of the terminal's
        start_new_session=True,  # Ctrl-C in the terminal reaches the daemon only, which ends the children in order
    )
    assert child.stdin is not None
    try:
        secret = seal.secret.hex() if seal is not None else ""
        child.stdin.write(f"{station.model_dump_json()}\n{secret}\n")
        child.stdin.flush()
    except BrokenPipeError:
        _log.error("node %s ended before it read its station", name)
    return child


def _await_ready(name: str, child: subprocess.Popen[str], clock: DeadlineClock) -> None:
    """Wait for the child's first line. Raises: DriverUnavailable, or the child's error; the child has ended then."""
    assert child.stdout is not None
    line = _line_within(child.stdout, START_TIMEOUT_S, clock)
    try:
        ready = decode(Ready, line.encode())
    except BadPayload as error:
        child.kill()
        raise DriverUnavailable(
            f"The node {name!r} did not start (exit code {child.wait()}).{clock.busy_note()}",
            "Its own message stands above.",
        ) from error
    if ready.error is not None:
        if not clock.wait_for(partial(_has_ended, child), _STOP_TIMEOUT_S):
            child.kill()
        raise error_from_reply(ready.error)


def _close_pipes(child: subprocess.Popen[str]) -> None:
    for pipe in (child.stdin, child.stdout):
        if pipe is not None:
            with suppress(BrokenPipeError):  # the unwritten rest is lost with the child
                pipe.close()


def _line_within(stream: IO[str], timeout_s: float, clock: DeadlineClock) -> str:
    """The stream's next line, or "" after ``timeout_s`` or at its end."""
    with selectors.DefaultSelector() as selector:
        selector.register(stream, selectors.EVENT_READ)
        return stream.readline() if clock.wait_for(selector.select, timeout_s) else ""


def _has_ended(child: subprocess.Popen[str], timeout_s: float) -> bool:
    """Wait for the end of ``child``, for ``timeout_s`` at most; True when it has ended."""
    with suppress(subprocess.TimeoutExpired):
        child.wait(timeout_s)
    return child.returncode is not None


def _own_stdout() -> IO[str]:
    """This process's stdout, reserved for our lines: output of vendor libraries goes to stderr from now on."""
    ours = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    return ours


def _serve_supervised(name: str, stdin: IO[str], stdout: IO[str]) -> int:
    """The child's side: read the station, serve node ``name``, end when stdin closes. Returns the exit code."""
    limit_malloc_arenas()
    station, secret = station_from(json.loads(stdin.readline())), bytes.fromhex(stdin.readline())
    try:
        with join_cell(station) as bus:
            bus.seal = Seal(secret) if secret else None
            node = Node(name, bus, open_devices(station.nodes[name].driver, station), station)
            with handled_by(partial(_end_by_defect, node)):
                node.open()
                _say(stdout, Ready(node=name, pid=os.getpid()))
                with freeze_gc():
                    stdin.read()
                node.close()
    except CellError as error:
        _say(stdout, Ready(node=name, pid=os.getpid(), error=error_reply(error)))
        return error.exit_code
    return 0


def _end_by_defect(node: Node, name: str, defect: BaseException) -> None:
    """End this process after a defect. The arm stops first, and the cell receives the reason."""
    try:
        node.end_by_defect(name, defect)
    finally:
        logging.shutdown()
        os._exit(_DEFECT_EXIT_CODE)


def serve_until_interrupted(name: str, station: Station) -> None:
    """Serve a node in a terminal of its own (``run = "elsewhere"``) until Ctrl-C, SIGTERM or SIGHUP.

    When the cell or the link to it is lost, the arm stops, because no stop of the cell could reach it.
    """
    limit_malloc_arenas()
    ended = threading.Event()
    on_end(ended.set)
    with ExitStack() as stack:
        bus = stack.enter_context(join_cell(station, station.bus.zenoh))
        node = Node(name, bus, open_devices(station.nodes[name].driver, station), station)
        stack.enter_context(handled_by(partial(_end_by_defect, node)))
        node.open()

        def change(client_id: str, is_alive: bool) -> None:
            if client_id == CELL_CLIENT and not is_alive:
                _log.warning("the cell, or the link to it, is gone")
                bus.worker("arm-stop").submit(node.halt)

        bus.watch_alive(topics.LEASE, change)
        try:
            with freeze_gc():
                ended.wait()
        finally:
            node.close()


def _say(stdout: IO[str], ready: Ready) -> None:
    stdout.write(encode(ready).decode() + "\n")
    stdout.flush()


if __name__ == "__main__":  # the child, without the imports of the command line
    log_plainly()
    stdin = io.TextIOWrapper(sys.stdin.buffer, encoding="utf-8")
    code = _serve_supervised(sys.argv[1], stdin, _own_stdout())
    logging.shutdown()
    os._exit(code)  # immediately: a thread inside MuJoCo or an SDK would abort the interpreter
