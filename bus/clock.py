"""The clock of every deadline that a station sets.

A station with real devices counts wall time. A simulation on one machine counts computing time: its clock runs slower
by the factor by which this process is starved, so a deadline means the same amount of work on every machine.
`config.clock.clock_of` chooses between the two.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Protocol

from bus.starvation import Starvation, StarvationMeter, load_now
from bus.threads import OwnedThread, Role

_LOOK_S = 0.05
_MEASURE_S = 0.2
_LONGEST_S = 0.3
"""Most time between two measurements [s]: a later one shows that this process did not run."""
_ORDINARY = 2.0
"""Slowdown of a cell that is alone on two cores: every deadline allows for it."""


class DeadlineClock(Protocol):
    """A clock, and the waits that it limits. Every member may be called from any thread."""

    @property
    def is_slowed(self) -> bool:
        """False when the clock shows wall time. When it does not, no library may count a deadline in wall time."""

    def now_s(self) -> float:
        """Return the time since an arbitrary moment [s]."""

    def wait_for(self, is_done: Callable[[float], object], limit_s: float) -> bool:
        """Wait until ``is_done`` is true, for ``limit_s`` at most.

        Args:
            is_done: waits for up to the given time [wall s], and returns whether the wait is over.

        Returns:
            False when the time is over.
        """

    def starvation(self) -> Starvation:
        """Return the load of the machine, and the starvation of this process as far as it is measured."""

    def busy_note(self) -> str:
        """Return a sentence for an error text, with a leading blank; "" when the machine is not too busy."""


class WallClock:
    """Wall time: the clock of real devices, whatever the load."""

    is_slowed = False

    def __init__(self, wall_s: Callable[[], float] = time.monotonic, load: Callable[[], Starvation] = load_now) -> None:
        self._wall_s, self._load = wall_s, load

    def now_s(self) -> float:
        return self._wall_s()

    def wait_for(self, is_done: Callable[[float], object], limit_s: float) -> bool:
        return bool(is_done(limit_s))

    def starvation(self) -> Starvation:
        return self._load()

    def busy_note(self) -> str:
        return _note(self.starvation())


class StarvedClock:
    """Computing time: 1 s passes while this process does the work of 1 s. Wall time where the load is ordinary.

    It needs `start`: no caller of `now_s` waits for a measurement, which reads many files; each read releases the
    interpreter lock, and takes 5 ms where another thread computes.

    Args:
        wall_s: monotonic clock.
        measure: returns the starvation since its last call.
    """

    is_slowed = True

    def __init__(
        self, wall_s: Callable[[], float] = time.monotonic, measure: Callable[[], Starvation] | None = None
    ) -> None:
        self._wall_s, self._measure = wall_s, measure or StarvationMeter().measure
        self._starvation = self._measure()
        self._turn = threading.Lock()  # guards the three below
        self._measured_at_s = wall_s()
        self._then_s = self._shown_s = 0.0  # the time at the last measurement, and as it was last shown

    def start(self) -> StarvedClock:
        """Measure from now on, in a thread of its own; returns itself."""
        OwnedThread(Role.CLOCK, self._run).start()
        return self

    def _run(self) -> None:
        while True:
            time.sleep(_MEASURE_S)
            self.tick()

    def tick(self) -> None:
        """Measure once; to be called every 0.2 s."""
        starvation = self._measure()
        with self._turn:
            now_s = self._then_s + self._since(starvation.slowdown)
            self._then_s = self._shown_s = max(self._shown_s, now_s)
            self._measured_at_s, self._starvation = self._wall_s(), starvation

    def now_s(self) -> float:
        with self._turn:
            self._shown_s = max(self._shown_s, self._then_s + self._since(self._starvation.slowdown))
            return self._shown_s

    def _since(self, slowdown: float) -> float:
        """Return the time since the last measurement."""
        since_s = min(self._wall_s() - self._measured_at_s, _LONGEST_S)
        return since_s / slowdown if slowdown > _ORDINARY else since_s

    def wait_for(self, is_done: Callable[[float], object], limit_s: float) -> bool:
        end_s = self.now_s() + limit_s
        while not (done := is_done(_LOOK_S)) and self.now_s() < end_s:
            pass
        return bool(done)

    def starvation(self) -> Starvation:
        return self._starvation

    def busy_note(self) -> str:
        return _note(self.starvation())


WALL_CLOCK = WallClock()


def _note(starvation: Starvation) -> str:
    text = starvation.in_words()
    return f" {text}" if text else ""
