"""A machine on which all work takes longer, and whose wall clock stands until the test moves it."""

from __future__ import annotations

import threading

from bus.clock import StarvedClock
from bus.starvation import Starvation

_TICK_S = 0.05


class StarvedMachine:
    """A second of work takes ``slowdown`` seconds on it.

    Attributes:
        clock: that of a simulated cell's deadlines.
    """

    def __init__(self, slowdown: float = 10.0) -> None:
        self.wall_s = 0.0
        self._looks = threading.Semaphore(0)
        self.clock = StarvedClock(self._look, lambda: Starvation(slowdown, 14.0, 2))

    def _look(self) -> float:
        self._looks.release()
        return self.wall_s

    def passes(self, wall_s: float) -> None:
        """Let so much wall time pass, and measure all along."""
        for _ in range(round(wall_s / _TICK_S)):
            self.wall_s += _TICK_S
            self.clock.tick()

    def await_looks(self, count: int) -> None:
        """Until a waiting thread has looked at the clock so many times more."""
        while self._looks.acquire(blocking=False):
            pass
        for _ in range(count):
            assert self._looks.acquire(timeout=10)
