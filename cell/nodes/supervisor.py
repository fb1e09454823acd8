"""Supervises driver nodes as child processes: vendor SDKs crash and hold the GIL, so each node is isolated.

The child's half is `cell.nodes.child`. It gets its station as one JSON line on stdin, and in another line the secret
that it shares with the cell. It answers with one line on stdout, `cell.nodes.ready.Ready`, and ends when its stdin
closes, so it never outlives the daemon.
"""

from __future__ import annotations

import logging
import subprocess
import threading
from collections.abc import Callable
from functools import partial

from bus.errors import CellError, DriverUnavailable
from bus.seal import Seal
from bus.threads import OwnedThread, Role
from cell.nodes.pipes import close_pipes, end_child
from cell.nodes.ready import Ready
from cell.nodes.starting import first_said, spawn_child
from config.clock import clock_of
from config.schema import Station
from drivers.node.registry import GROUP as DRIVERS

_log = logging.getLogger(__name__)
START_TIMEOUT_S = 60.0
_STOP_TIMEOUT_S = 5.0
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.5, 30.0


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
            self._await_ready(name, child)
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
            if not end_child(child, _STOP_TIMEOUT_S, self._clock):
                _log.warning("node %s did not end by itself; it was killed", name)
        for watcher in self._watchers:
            watcher.join(_STOP_TIMEOUT_S)
        for child in self._children.values():
            close_pipes(child)

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
            close_pipes(child)
            self._on_exit(name, code)
            if not self._bring_back(name):
                return
            self._restarts[name] = self.restarts(name) + 1
            self._on_back(name)

    def _bring_back(self, name: str) -> bool:
        """Retry until the node serves; False when the supervisor closes first."""
        pause_s, said = _FIRST_PAUSE_S, ""
        while not self._closing.wait(pause_s) and self._spawn(name):
            try:
                self._await_ready(name, self._children[name])
            except CellError as error:
                if str(error) != said:  # once, not with every try: its health says all the time that it is not up
                    said = str(error)
                    _log.warning("node %s cannot be brought back yet: %s", name, said)
                pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
            else:
                self._serving.add(name)
                return True
        return False

    def _await_ready(self, name: str, child: subprocess.Popen[str]) -> None:
        """Wait for the child's first line. Raises: DriverUnavailable, or the child's error; it has ended then."""
        driver = self._station.nodes[name].driver
        package = DRIVERS.package_of(driver)
        whose = f"its driver {driver!r}{f' of {package}' if package else ''}"

        def slow() -> None:
            _log.warning("node %s does not serve yet: waiting for %s, up to %g s", name, whose, START_TIMEOUT_S)

        def silent(code: int | None) -> CellError:
            if code is None:
                what = f"The node {name!r} did not start within {START_TIMEOUT_S:g} s: {whose} does not answer."
                advice = "Is its device on and connected? What else it waits for says its own documentation."
                return DriverUnavailable(f"{what}{self._clock.busy_note()}", advice)
            what = f"The node {name!r} did not start (exit code {code}).{self._clock.busy_note()}"
            return DriverUnavailable(what, "Its own message stands above.")

        first_said(child, Ready, START_TIMEOUT_S, self._clock, silent, slow)


def _child(name: str, station: Station, seal: Seal | None = None) -> subprocess.Popen[str]:
    secret = seal.secret.hex() if seal is not None else ""
    return spawn_child(station, "cell.nodes", name, secret=secret)
