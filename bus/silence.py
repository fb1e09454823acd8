"""Notices that somebody who should be heard has fallen silent."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable


class Silence:
    """The silence of one other side, looked at often; every member may be called from any thread.

    Time in which this process itself stood still does not count: what was said meanwhile is still on its way.

    Args:
        limit_s: silent for longer, and it is missed. ``look_s``: how often `is_broken` is asked.
        clock_s: monotonic.
    """

    def __init__(self, limit_s: float, look_s: float, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._limit_s, self._look_s, self._clock_s = limit_s, look_s, clock_s
        self._changing = threading.Lock()
        self._heard_s = self._looked_s = clock_s()

    def hear(self) -> None:
        """It said something."""
        with self._changing:
            self._heard_s = self._clock_s()

    def for_s(self) -> float:
        """How long it has said nothing; asked every ``look_s``."""
        with self._changing:
            now_s = self._clock_s()
            late_s = now_s - self._looked_s - 2 * self._look_s
            if late_s > 0:
                self._heard_s = min(now_s, self._heard_s + late_s)
            self._looked_s = now_s
            return now_s - self._heard_s

    def is_broken(self) -> bool:
        """Whether it has been silent for too long; asked every ``look_s``."""
        return self.for_s() > self._limit_s
