"""Doors: processes beside the cell that serve it to programs which do not speak its bus (OPC UA, HTTP).

A door is a client of the cell, as any other: it can neither do more, nor take the cell with it when it dies. The
child's half is `cell.nodes.door_child`: it gets its station as one JSON line on stdin, answers with one line on stdout,
`cell.nodes.ready.Open`, and ends when its stdin closes.
"""

from __future__ import annotations

import logging
import subprocess
import threading
from collections.abc import Callable
from typing import Literal

from bus.clock import DeadlineClock
from bus.commands import DoorHealth
from bus.errors import CellError
from bus.threads import OwnedThread, Role
from cell.nodes.health import is_halted
from cell.nodes.pipes import close_pipes, end_child, has_ended
from cell.nodes.ready import Open
from cell.nodes.starting import first_said, spawn_child
from config.clock import clock_of
from config.schema import Station

_log = logging.getLogger(__name__)
_OPEN_S = 120.0
"""Longest time until a door is open; some take 10 s of computing."""
_STOP_TIMEOUT_S = 5.0
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.5, 30.0
_LOOK_S, _FROZEN_S = 0.25, 2.0
"""How often a door's process is looked at, and for how long it may be halted."""
_FOR_GOOD = 2
"""Exit code of an error that another try would only repeat: usage, configuration."""

News = Callable[[str, Literal["info", "warning", "error"], str, str], None]
"""Called with code, severity, text and advice of an event."""
HealthNews = Callable[[str, DoorHealth], None]
"""Called with the name of a door, and how it is now."""


class Door:
    """One door of a running cell: its process is started again, with growing pauses, until `close`.

    Args:
        name: of its command, which `cell` lists.
        on_news: publishes an event, from any thread. What keeps a door closed is said once, not with every try.
        spawn: starts the door's process.
        on_health: told of every change, from any thread.
    """

    def __init__(
        self,
        name: str,
        station: Station,
        on_news: News,
        spawn: Callable[[str, Station], subprocess.Popen[str]] | None = None,
        on_health: HealthNews = lambda name, health: None,
    ) -> None:
        self._name, self._station, self._on_news = name, station, on_news
        self._on_health, self._health = on_health, DoorHealth()
        self._spawn = spawn or door_child
        self._clock = clock_of(station)
        self._child: subprocess.Popen[str] | None = None
        self._closing = threading.Event()
        self._spawning = threading.Lock()  # no process is spawned once closing is set
        self._thread = OwnedThread(Role.SUPERVISOR, self._keep_open, of=name)

    def start(self) -> Door:
        """Start the door's process in the background and return at once."""
        self._thread.start()
        return self

    def close(self) -> None:
        """End the door's process: first by closing its stdin, then by force; idempotent."""
        with self._spawning:
            self._closing.set()
        child = self._child
        if child is not None and not end_child(child, _STOP_TIMEOUT_S, self._clock):
            _log.warning("the door %s did not end by itself; it was killed", self._name)
        self._thread.join(_STOP_TIMEOUT_S)
        if child is not None:
            close_pipes(child)

    def _keep_open(self) -> None:
        """Run one process after the other until `close`, or until one ends for good."""
        pause_s = 0.0
        self._on_health(self._name, self._health)
        while not self._closing.wait(pause_s):
            with self._spawning:
                if self._closing.is_set():
                    return
                self._child = child = self._spawn(self._name, self._station)
            try:
                where = await_open(child, self._clock)
            except CellError as error:
                if not self._closing.is_set():
                    self._tell_closed(error)
                if error.exit_code == _FOR_GOOD:
                    return
                pause_s = min(max(2 * pause_s, _FIRST_PAUSE_S), _LONGEST_PAUSE_S)
                continue
            self._turn(DoorHealth(endpoint=where))
            self._on_news("DOOR_OPEN", "info", f"The door {self._name!r} is open: {where}.", "")
            code = _await_end(child)
            if self._closing.is_set():
                return
            close_pipes(child)
            pause_s = _FIRST_PAUSE_S
            ended = f"ended with exit code {code}; it is started again."
            self._turn(DoorHealth(problem=ended))
            self._on_news(
                "DOOR_LOST",
                "warning",
                f"The door {self._name!r} {ended}",
                "Its own message stands above. What its clients had in motion is held.",
            )

    def _tell_closed(self, error: CellError) -> None:
        again = "" if error.exit_code == _FOR_GOOD else " It is tried again until it opens."
        problem = f"cannot open: {error.text}{again}"
        if self._turn(DoorHealth(problem=problem, advice=error.advice)):
            self._on_news("DOOR_CLOSED", "error", f"The door {self._name!r} {problem}", error.advice)

    def _turn(self, health: DoorHealth) -> bool:
        """Tell how the door is now; False where it was so before."""
        is_new = health != self._health
        if is_new:
            self._health = health
            self._on_health(self._name, health)
        return is_new


def _await_end(child: subprocess.Popen[str]) -> int:
    """Wait for the end of an open door; one that a signal has halted answers nobody, and is killed."""
    halted_s = 0.0
    while not has_ended(child, _LOOK_S):
        halted_s = halted_s + _LOOK_S if is_halted(child.pid) else 0.0
        if halted_s > _FROZEN_S:
            _log.warning("a door's process is halted; killing it")
            child.kill()
    return child.wait()


def door_child(name: str, station: Station) -> subprocess.Popen[str]:
    """Start a door's process, which reads its station on stdin."""
    return spawn_child(station, "cell", name, "--supervised")


def await_open(child: subprocess.Popen[str], clock: DeadlineClock) -> str:
    """Wait for the child's first line; return its endpoint. Raises: the child's error; the child has ended then."""

    def silent(code: int | None) -> CellError:
        why = f"within {_OPEN_S:g} s" if code is None else f"(exit code {code})"
        return CellError(f"its process said nothing {why}.", "Its own message stands above.")

    return first_said(child, Open, _OPEN_S, clock, silent).endpoint
