"""The demands of planning on an arm's kinematics, and what makes one configuration better than another.

The FR3 has a closed form (`planning.kinematics`), any other arm a numerical one (`planning.serial_arm`).
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import numpy.typing as npt

from bus.arrays import Joints, JointSamples
from config.limits import JointLimits

Array = npt.NDArray[np.float64]


class Arm(Protocol):
    """The inverse kinematics of an arm with n joints.

    Attributes:
        limits: of the joints.
    """

    @property
    def limits(self) -> JointLimits:
        """The limits of the joints."""

    def solutions(self, base_from_flange: Array, margin_rad: float) -> tuple[JointSamples, npt.NDArray[np.int64]]:
        """Return configurations (k, n) that bring the flange to one of the poses (p, 4, 4), and each one's pose (k,).

        Args:
            margin_rad: distance that they keep from the position limits.
        """

    def line(self, q_from_rad: Joints, base_from_flange: Array) -> JointSamples | None:
        """Return the path (m, n) through the poses (m, 4, 4), the first of which is the start's; None without one."""

    def manipulability(self, q_rad: JointSamples) -> Array:
        """Return Yoshikawa's measure ``sqrt(det(J Jt))`` (k,) of the flange; 0 = singular."""


def rest_to_rest_s(limits: JointLimits, q_from_rad: Array, q_to_rad: Array) -> Array:
    """Return the shortest time (...) [s] of a joint motion (..., n) from rest to rest within speed and acceleration."""
    distance = np.abs(q_to_rad - q_from_rad)
    speed = limits.velocity_bounds((limits.lower_rad + limits.upper_rad) / 2)[1]
    most = limits.acceleration_rad_s2
    ramp = speed**2 / most
    short, long = 2 * np.sqrt(distance / most), distance / speed + speed / most
    return np.asarray(np.where(distance < ramp, short, long).max(axis=-1))


def limit_distance_rad(limits: JointLimits, q_rad: Array) -> Array:
    """Return the distance (...) of the nearest joint of (..., n) to its position limit; negative outside.

    It is NaN where ``q_rad`` is.
    """
    return np.asarray(np.minimum(q_rad - limits.lower_rad, limits.upper_rad - q_rad).min(axis=-1))


def cost(arm: Arm, q_from_rad: Joints, q_rad: JointSamples) -> Array:
    """Return the cost (k,) of solutions (k, n), lower is better.

    It is the shortest travel time [s] plus penalties near singularities and near position limits.
    """
    singular = np.maximum(0.0, 0.06 - arm.manipulability(q_rad)) / 0.06
    near_limit = np.maximum(0.0, 0.1 - limit_distance_rad(arm.limits, q_rad)) / 0.1
    return np.asarray(rest_to_rest_s(arm.limits, q_from_rad, q_rad) + 0.3 * singular + 0.3 * near_limit)
