"""Bounds the acceleration of the tcp on a timed path, for what hangs in the hand. Frames: docs/frames.md."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from planning.blend import Curve
from planning.lean_toppra import LinearConstraint
from planning.robot import Robot

Array = npt.NDArray[np.float64]

_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / np.sqrt(3)
_DIRECTIONS = np.concatenate([np.eye(3), -np.eye(3), _CORNERS])
"""The acceleration's component along each of these is bounded: its norm then exceeds the bound by 13 % at most."""
_NORM_OVER = 0.88
_SAMPLES = 121


class CalmTcp(LinearConstraint):  # type: ignore[misc]
    """A bound on the tcp's linear acceleration along one curve, as toppra takes it.

    The tcp's place p(s) by arc length s gives the acceleration p'(s) u + p''(s) x, with the path acceleration u and the
    squared path speed x. The methods override those of toppra's ``LinearConstraint``.

    Args:
        curve: of the joints; its arc length is the path's.
        most_m_s2: bound of the norm.
    """

    def __init__(self, robot: Robot, curve: Curve, most_m_s2: float) -> None:
        super().__init__()
        at = np.linspace(0, len(curve.at_rad) - 1, min(_SAMPLES, len(curve.at_rad))).astype(int)
        places_m = np.array([robot.base_from_tcp(q)[:3, 3] for q in curve.points_rad[at]])
        self._tcp_m = CubicSpline(curve.at_rad[at], places_m)
        self._joints = robot.arm.limits.joints
        self._most_m_s2 = _NORM_OVER * most_m_s2
        self.identical = True

    def get_dof(self) -> int:
        """Return the number of joints."""
        return self._joints

    def compute_constraint_params(self, _path: Any, gridpoints: Array, *_: Any) -> tuple[Any, ...]:
        """Return toppra's (a, b, c, F, g, ubound, xbound) at arc lengths (n,) [rad]."""
        along, bend = self._tcp_m(gridpoints, 1), self._tcp_m(gridpoints, 2)
        most = np.full(len(_DIRECTIONS), self._most_m_s2)
        return along, bend, np.zeros_like(along), _DIRECTIONS, most, None, None
