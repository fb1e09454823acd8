"""The daemon's watchdog thread: checks nodes and lease, publishes the cell's health, and ends frozen nodes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from bus.commands import CellHealth
from bus.threads import OwnedThread, Role
from cell.nodes.health import LOOK_PERIOD_S, NodeMonitor
from config.schema import Station

_HEALTH_PERIOD_S = 1.0


class Watchdog:
    """A thread from `start` to `close`.

    Args:
        monitor: of the nodes. ``look_at_lease``: takes the lease from a silent client.
        say_health: called with the cell's health once a second. ``health``: gives it.
        end_frozen: called once with the name of a node that has been silent for `bus.frozen_s`.
    """

    def __init__(
        self,
        station: Station,
        monitor: NodeMonitor,
        say_health: Callable[[CellHealth], None],
        end_frozen: Callable[[str], None],
        look_at_lease: Callable[[], None],
        health: Callable[[], CellHealth],
    ) -> None:
        self._station, self._monitor = station, monitor
        self._say_health, self._end_frozen = say_health, end_frozen
        self._look_at_lease, self._health = look_at_lease, health
        self._ended: set[str] = set()
        self._closing = threading.Event()
        self._thread = OwnedThread(Role.WATCHDOG, self._run)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self) -> None:
        """End the thread; idempotent."""
        self._closing.set()
        self._thread.join()

    def is_alive(self) -> bool:
        """True while the thread runs."""
        return self._thread.is_alive()

    def _run(self) -> None:
        said_s = 0.0
        while not self._closing.wait(LOOK_PERIOD_S):
            self._monitor.look()
            self._look_at_lease()
            for name in self._station.nodes:
                self._end_if_frozen(name)
            if time.monotonic() - said_s >= _HEALTH_PERIOD_S:
                said_s = time.monotonic()
                self._say_health(self._health())

    def _end_if_frozen(self, name: str) -> None:
        is_frozen = self._monitor.unheard_for_s(name) > self._station.bus.frozen_s
        if is_frozen and name not in self._ended:
            self._end_frozen(name)
        self._ended = self._ended | {name} if is_frozen else self._ended - {name}
