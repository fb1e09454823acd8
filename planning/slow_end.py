"""The slow end of an approach, on which what the arm meets is touched softly.

The force of a blow is about ``execute.contact_n`` plus what the arm runs on while it brakes, times its stiffness (10 to
100 N/mm). So the last ``execute.slow_m`` are no faster than ``execute.slow_m_s`` where something is believed to be so
near that it may be met, and than ``execute.free_m_s`` elsewhere. Frames: docs/frames.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bus.arrays import JointSamples, Vector3
from config.schema import ExecuteSettings
from planning.robot import Robot

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class SlowEnd:
    """A bound on the speed of the tcp near the end of a path.

    Attributes:
        end_m: (3,) where the tcp ends in ``base``. ``slow_m``: how near to it the bound holds. ``slow_m_s``: the bound.
    """

    robot: Robot
    end_m: Vector3
    slow_m: float
    slow_m_s: float

    def is_near(self, q_rad: JointSamples) -> npt.NDArray[np.bool_]:
        """Return (n,): whether the bound holds at each of ``q_rad`` (n, joints)."""
        away_m = np.array([np.linalg.norm(self.robot.base_from_tcp(q)[:3, 3] - self.end_m) for q in q_rad])
        return np.asarray(away_m <= self.slow_m)

    def path_speeds(self, q_rad: JointSamples, slope: JointSamples) -> Array:
        """Return (n,) the fastest path speed at each ``q_rad``, where dq/ds is ``slope``; both (n, joints)."""
        fastest = np.full(len(q_rad), np.inf)
        for row in np.flatnonzero(self.is_near(q_rad)):
            tcp_per_path = np.linalg.norm(self.robot.jacobian(q_rad[row])[:3] @ slope[row])
            fastest[row] = self.slow_m_s / max(float(tcp_per_path), 1e-12)
        return fastest


def slow_end(robot: Robot, end_m: Vector3, settings: ExecuteSettings, *, is_near: bool) -> SlowEnd | None:
    """Return the bound for an approach that ends at ``end_m`` (3,); None where contact is not felt.

    Args:
        is_near: whether anything is believed to be near the hand there.
    """
    if not settings.contact_n or not settings.slow_m:
        return None
    return SlowEnd(robot, end_m, settings.slow_m, settings.slow_m_s if is_near else settings.free_m_s)
