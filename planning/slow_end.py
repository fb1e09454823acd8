"""The slow end of an approach, on which what the arm meets is touched softly.

The force of a blow is the speed times about 1 N for 1 mm/s: it is over in 5 ms, before the arm has braked. So the last
``execute.slow_m`` are no faster than ``execute.slow_m_s`` where something is believed to be so near that it may be met,
and than ``execute.free_m_s`` elsewhere. Before them, ``execute.beside_m`` are no faster than ``execute.beside_m_s``,
from where the hand first passes things, or space that no look saw: what is hidden there is met less hard.
Frames: docs/frames.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bus.arrays import Joints, JointSamples, Vector3
from config.pick import ExecuteSettings
from planning.robot import Robot

Array = npt.NDArray[np.float64]
Near = Callable[[Joints], bool]

_LOOKS_AT = (1.0, 0.75, 0.5, 0.25)
"""Shares of ``execute.beside_m``, at which it is asked whether anything is near, from its beginning on."""
_JOINT_RAD_PER_M = 5.0
"""There no joint is faster than so many rad for each metre of the bound: it would take too long to brake it. A median
approach turns its fastest joint by 5.4 rad/m; one in ten by more than 9.5."""


class Step(NamedTuple):
    """A bound on the speeds of the tcp and of every joint, no farther than ``within_m`` from the tcp's end."""

    within_m: float
    tcp_m_s: float
    joint_rad_s: float = np.inf


@dataclass(frozen=True)
class SlowEnd:
    """A bound on the speed of the tcp near the end of a path.

    Attributes:
        end_m: (3,) where the tcp ends in ``base``.
        steps: the nearest and slowest first.
    """

    robot: Robot
    end_m: Vector3
    steps: tuple[Step, ...]

    def step_at(self, q_rad: JointSamples) -> npt.NDArray[np.int64]:
        """Return (n,) which of the steps holds at each of ``q_rad`` (n, joints); their number where none does."""
        away_m = np.array([np.linalg.norm(self.robot.base_from_tcp(q)[:3, 3] - self.end_m) for q in q_rad])
        return np.searchsorted([step.within_m for step in self.steps], away_m)

    def path_speeds(self, q_rad: JointSamples, slope: JointSamples) -> Array:
        """Return (n,) the fastest path speed at each ``q_rad``, where dq/ds is ``slope``; both (n, joints)."""
        fastest = np.full(len(q_rad), np.inf)
        for row, at in enumerate(self.step_at(q_rad)):
            if at < len(self.steps):
                step, tcp_per_path = self.steps[at], np.linalg.norm(self.robot.jacobian(q_rad[row])[:3] @ slope[row])
                by_joint = step.joint_rad_s / max(float(np.abs(slope[row]).max()), 1e-12)
                fastest[row] = min(step.tcp_m_s / max(float(tcp_per_path), 1e-12), by_joint)
        return fastest


def slow_end(
    robot: Robot, line_rad: JointSamples, settings: ExecuteSettings, is_near: Near, is_beside: Near
) -> SlowEnd | None:
    """Return the bound for an approach along ``line_rad`` (n, joints); None where contact is not felt.

    Args:
        is_near: whether in a configuration (joints,) anything is believed to be near the hand.
        is_beside: the same within a few centimetres.
    """
    if not settings.contact_n or not settings.slow_m:
        return None
    end_m = robot.base_from_tcp(line_rad[-1])[:3, 3]
    steps = [Step(settings.slow_m, settings.slow_m_s if is_near(line_rad[-1]) else settings.free_m_s)]
    away_m = np.array([np.linalg.norm(robot.base_from_tcp(q)[:3, 3] - end_m) for q in line_rad])
    for share in _LOOKS_AT:
        before_m = settings.slow_m + share * settings.beside_m
        if settings.beside_m and is_beside(line_rad[int(np.argmin(abs(away_m - before_m)))]):
            fast = Step(before_m, settings.beside_m_s, settings.beside_m_s * _JOINT_RAD_PER_M)
            return SlowEnd(robot, end_m, (*steps, fast))
    return SlowEnd(robot, end_m, tuple(steps))
