"""Whether the arm reaches a place at all, in any direction of the hand: before a job is taken.

Frames: docs/frames.md.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from bus.arrays import Vector3
from planning.arm import Arm
from planning.pregrasp import LOWER_M
from planning.robot import flange_pose
from planning.search import LIMIT_MARGIN_RAD

_TILTS_RAD = (0.0, 0.35, 0.7, 1.05, 1.5)
"""From straight down to level: as far as a grasp may lean, what is laid down keeps its tilt."""
_AROUND_RAD, _TURNS_RAD = np.arange(8) * np.pi / 4, np.arange(6) * np.pi / 3


def reaches(arm: Arm, place_m: Vector3) -> bool:
    """Return whether some arm configuration brings the tcp above ``place_m`` (3,) in ``base``, to lay something down.

    True says only that it can be: a thing's tilt, a given heading or an obstacle may still prevent it. An arm with a
    closed form answers in a tenth of a second at most.
    """
    above_m = np.asarray(place_m, dtype=float) + np.array([0.0, 0.0, LOWER_M])
    for tilt_rad in _TILTS_RAD:
        poses = np.tile(np.eye(4), (len(_directions(tilt_rad)), 1, 1))
        poses[:, :3, :3], poses[:, :3, 3] = _directions(tilt_rad), above_m
        if len(arm.solutions(flange_pose(poses), LIMIT_MARGIN_RAD)[0]):
            return True
    return False


@cache
def _directions(tilt_rad: float) -> npt.NDArray[np.float64]:
    """Rotations (n, 3, 3) of the hand that lean so far from straight down, all around."""
    around_rad = _AROUND_RAD if tilt_rad else _AROUND_RAD[:1]
    angles = [(around, np.pi - tilt_rad, turn) for around in around_rad for turn in _TURNS_RAD]
    return np.asarray(Rotation.from_euler("ZYZ", angles).as_matrix())
