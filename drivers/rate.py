"""How often something happened lately."""

from __future__ import annotations

from collections import deque

_WINDOW_S = 2.0


class Rate:
    """Counts what happens in the last two seconds, by a clock of the caller's."""

    def __init__(self) -> None:
        self._when_s: deque[float] = deque()

    def count(self, now_s: float) -> None:
        self._when_s.append(now_s)
        self._forget(now_s)

    def hz(self, now_s: float) -> float:
        """0 as soon as nothing happens any more."""
        self._forget(now_s)
        return len(self._when_s) / _WINDOW_S

    def _forget(self, now_s: float) -> None:
        while self._when_s and self._when_s[0] < now_s - _WINDOW_S:
            self._when_s.popleft()
