"""Measures the recent rate of an event."""

from __future__ import annotations

from collections import deque

_WINDOW_S = 2.0


class Rate:
    """Counts events of the last two seconds, by a monotonic clock of the caller's."""

    def __init__(self) -> None:
        self._when_s: deque[float] = deque()

    def count(self, now_s: float) -> None:
        """Count one event at ``now_s``."""
        self._when_s.append(now_s)
        self._forget(now_s)

    def hz(self, now_s: float) -> float:
        """Return the mean rate [Hz] over the two seconds before ``now_s``; 0 without events."""
        self._forget(now_s)
        return len(self._when_s) / _WINDOW_S

    def _forget(self, now_s: float) -> None:
        while self._when_s and self._when_s[0] < now_s - _WINDOW_S:
            self._when_s.popleft()
