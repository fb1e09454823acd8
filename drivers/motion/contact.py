"""Feels whether a motion meets something, tick by tick, from the external torques. Every arm uses it."""

from __future__ import annotations

import numpy as np

from bus.arrays import Joints
from bus.trajectory import ContactGuard

_CALM_TICKS = 5
"""The force before contact is the mean of so many samples, from where the guard begins."""
_SURE_TICKS = 2
"""So many samples in a row must exceed the limit: a single one may be noise."""


class Feeler:
    """Compares the force against a motion with what it was when the guarded part began.

    Args:
        guard: None = it feels nothing.
        end_at: last tick of the filtered motion.

    Attributes:
        since_at: the place [ticks] where the force of now first exceeded the limit.
    """

    def __init__(self, guard: ContactGuard | None, end_at: int) -> None:
        self._guard, self._end_at = guard, end_at
        self._calm_n: list[float] = []
        self._over_ticks = 0
        self.since_at = 0.0

    def is_due(self, at: float) -> bool:
        """Whether the motion is to be felt at this place [ticks]."""
        return self._guard is not None and at >= self._guard.begins_at

    def contact_n(self, at: float, tau_ext_nm: Joints) -> float | None:
        """Return the force [N] that is contact, or None; to be asked once a tick where it `is_due`.

        Args:
            at: the place along the filtered motion [ticks].
            tau_ext_nm: (joints,) external torques measured there.
        """
        guard = self._guard
        if guard is None or at < guard.begins_at:
            return None
        force_n = float(self._weights(guard, at) @ tau_ext_nm)
        if len(self._calm_n) < _CALM_TICKS:
            self._calm_n.append(force_n)
            return None
        felt_n = force_n - float(np.mean(self._calm_n))
        if not self._over_ticks:
            self.since_at = at
        self._over_ticks = self._over_ticks + 1 if felt_n > guard.limit_n else 0
        return felt_n if self._over_ticks >= _SURE_TICKS else None

    def _weights(self, guard: ContactGuard, at: float) -> Joints:
        rows = guard.force_from_torque
        share = (at - guard.begins_at) / max(1, self._end_at - guard.begins_at)
        return np.asarray(rows[min(len(rows) - 1, round(share * (len(rows) - 1)))])
