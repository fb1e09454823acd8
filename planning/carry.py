"""Limits for carrying: the held object must neither sink nor tip on the way."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bus.arrays import Joints
from planning.robot import Robot

CARRY_DIP_M = 0.02
CARRY_TILT_RAD = np.radians(20.0)
"""Limits of a held object on a joint line: sinking below both ends, and tilt beyond the angle between them."""
_SEARCHED_TILT_RAD = np.radians(25.0)


def keeps_level(robot: Robot, q_from_rad: Joints, q_to_rad: Joints) -> bool:
    """Whether the straight joint line between two configurations (n,) keeps within the dip (20 mm) and tilt limits."""
    poses = np.stack([robot.base_from_tcp(q) for q in np.linspace(q_from_rad, q_to_rad, 11)])
    heights_m, axes = poses[:, 2, 3], poses[:, :3, 2]
    turned = np.arccos(np.clip(axes @ axes[0], -1.0, 1.0))
    dip_m = min(heights_m[0], heights_m[-1]) - heights_m.min()
    return bool(dip_m <= CARRY_DIP_M and turned.max() - turned[-1] <= CARRY_TILT_RAD)


def within_max_tilt(robot: Robot, q_from_rad: Joints, q_to_rad: Joints) -> Callable[[Joints], bool]:
    """Return a check whether a configuration (n,) tilts the hand at most 25° more than the two ends of a path do."""
    lowest = max(robot.base_from_tcp(q)[2, 2] for q in (q_from_rad, q_to_rad))
    bound = np.cos(min(np.pi, np.arccos(np.clip(-lowest, -1.0, 1.0)) + _SEARCHED_TILT_RAD))

    def allowed(q: Joints) -> bool:
        return bool(-robot.base_from_tcp(q)[2, 2] >= bound)

    return allowed
