"""One motion of the simulated fingers, tick by tick: a ramp of their target, until they rest where they are to."""

from __future__ import annotations

from collections.abc import Callable

from bus.trajectory import TICK_S

_STILL_M = 2e-5
_STILL_TICKS = 30
"""Fingers rest when their width changes by no more in so many consecutive ticks."""
_PATIENCE_TICKS = 5000
_SQUEEZE_M = 0.010
"""Target beyond closed for a grasp: enough to press with full force on a thin object."""
_PRESSING = 0.99


class Fingers:
    """Fingers under way to a width, or until they press.

    Args:
        now_m: the width at the start. ``to_m``: the width to reach; None = close until they press, and keep pressing.
        speed_m_s: rate of the target.
        force_n: largest force of each finger.
        stopped: whether a stop came since.

    Attributes:
        target_m: the width that is commanded.
        is_over: they rest, were stopped, or do not get there.
    """

    def __init__(
        self, now_m: float, to_m: float | None, speed_m_s: float, force_n: float, stopped: Callable[[], bool]
    ) -> None:
        self.target_m, self.force_n, self.is_over = now_m, force_n, False
        self._grasps, self._end_m = to_m is None, -_SQUEEZE_M if to_m is None else to_m
        self._step_m, self._stopped = speed_m_s * TICK_S, stopped
        self._last_m, self._still_ticks, self._ticks = now_m, 0, 0

    def begin_tick(self) -> None:
        """Move the target on, unless a stop came: then the fingers stay where they are."""
        if self._stopped():
            self.is_over = True
            return
        self.target_m += max(-self._step_m, min(self._step_m, self._end_m - self.target_m))

    def end_tick(self, width_m: float, pressing_n: float) -> None:
        """Look whether they rest at their end, or on what they press with full force.

        Args:
            width_m: measured now. ``pressing_n``: force with which each finger closes.
        """
        self._ticks += 1
        is_still = abs(width_m - self._last_m) < _STILL_M
        self._still_ticks = self._still_ticks + 1 if is_still else 0
        self._last_m = width_m
        is_pressing = self._grasps and pressing_n >= _PRESSING * self.force_n
        rests = self._still_ticks >= _STILL_TICKS and (is_pressing or self.target_m == self._end_m)
        if rests or self._ticks >= _PATIENCE_TICKS:
            self.target_m = self._end_m  # a grasp goes on pressing when the object yields
            self.is_over = True
