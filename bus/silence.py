"""Detects that another process, which should publish regularly, has fallen silent."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable


class Silence:
    """The silence of one other process; every method may be called from any thread.

    Time in which this process itself stood still does not count, because samples from that time are still on their way.

    Args:
        limit_s: a longer silence is a loss. ``look_s``: the period at which `is_broken` is called.
        clock_s: monotonic.
    """

    def __init__(self, limit_s: float, look_s: float, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._limit_s, self._look_s, self._clock_s = limit_s, look_s, clock_s
        self._changing = threading.Lock()
        self._heard_s = self._looked_s = clock_s()

    def hear(self) -> None:
        """Note that a sample arrived."""
        with self._changing:
            self._heard_s = self._clock_s()

    def for_s(self) -> float:
        """Return how long nothing arrived [s]; call it every ``look_s``."""
        with self._changing:
            now_s = self._clock_s()
            late_s = now_s - self._looked_s - 2 * self._look_s
            if late_s > 0:
                self._heard_s = min(now_s, self._heard_s + late_s)
            self._looked_s = now_s
            return now_s - self._heard_s

    def is_broken(self) -> bool:
        """Whether the silence is longer than ``limit_s``; call it every ``look_s``."""
        return self.for_s() > self._limit_s
