"""The views of the wrist camera when one look is not enough: a short table of viewpoints about a place.

Measured: a fixed pair at 45 degrees sees as much as a search for the next best view (docs/method.md). Frames:
docs/frames.md.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import islice, product

import numpy as np
import numpy.typing as npt

from bus.arrays import Joints
from bus.codes import Code
from bus.errors import CycleFailure
from bus.trajectory import Trajectory
from bus.transforms import inverse
from config.scene import Box
from config.schema import Station
from planning.candidates import configurations
from planning.motion import move
from planning.robot import HAND_FROM_TCP, hand_from_color
from planning.scene import Scene
from planning.viewpoints import looking_at

_TABLE_DEG = ((45.0, 120.0), (45.0, 240.0), (30.0, 120.0), (30.0, 240.0), (45.0, 150.0), (45.0, 210.0), (30.0, 180.0))
"""Tilt from the vertical, and azimuth about the place; azimuth 0 lies beyond it, seen from the robot."""
_DISTANCES_M = (0.70, 0.62, 0.56)
_ROLLS_DEG = (60.0, 90.0, 30.0, 0.0, -30.0)
"""About the optical axis, the quickest first. Looks from the left and from the right are rolled against each other,
which shows a mounting that is off along the picture's rows, too."""
_EXAMINED = 8
_AHEAD_M = 0.03
"""Height above the table of the place that is looked at."""
_APART_DEG = 25.0
"""Two viewpoints so near to each other show the same."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Viewpoint:
    """One place to look from.

    Attributes:
        tilt_deg, azimuth_deg: see `_TABLE_DEG`.
        motion: from where the arm is.
    """

    tilt_deg: float
    azimuth_deg: float
    motion: Trajectory


def unseen(station: Station) -> Box:
    """All of the pick region as an obstacle, as high as an object may be: more may stand there than was seen."""
    x_min, x_max, y_min, y_max = station.scene.pick_region_m
    height_m, top_m = station.scene.max_height_m, station.scene.table.top_m
    center_m = ((x_min + x_max) / 2, (y_min + y_max) / 2, top_m + height_m / 2)
    return Box(name="unseen", center_m=center_m, size_m=(x_max - x_min, y_max - y_min, height_m))


def next_look(scene: Scene, q_now_rad: Joints, taken: Collection[tuple[float, float]]) -> Viewpoint:
    """Return the first viewpoint about the pick region that the arm reaches, away from those ``taken``.

    Args:
        scene: the obstacles; `unseen` must be among them.
        q_now_rad: (joints,) where the arm rests.
        taken: (tilt, azimuth) [deg] of earlier looks.

    Raises: CycleFailure: UNREACHABLE when there is none; STOPPED by the scene's ``cancel``.
    """
    x_min, x_max, y_min, y_max = scene.station.scene.pick_region_m
    center_m = np.array([(x_min + x_max) / 2, (y_min + y_max) / 2, scene.station.scene.table.top_m + _AHEAD_M])
    why = "all of them were taken"
    for tilt_deg, azimuth_deg in _TABLE_DEG:
        if any(_apart_deg((tilt_deg, azimuth_deg), other) < _APART_DEG for other in taken):
            continue
        for q_rad in _configurations(scene, center_m, tilt_deg, azimuth_deg, q_now_rad):
            try:
                return Viewpoint(tilt_deg, azimuth_deg, move(scene, q_now_rad, q_rad))
            except CycleFailure as failure:
                if failure.failure is Code.STOPPED:
                    raise
                why = failure.text
                break  # another configuration of the same place hardly ever helps
    raise CycleFailure(Code.UNREACHABLE, f"The camera reaches no other place to look from: {why}.")


def _configurations(
    scene: Scene, center_m: Array, tilt_deg: float, azimuth_deg: float, q_from_rad: Joints
) -> Iterator[Joints]:
    """Free configurations (n,) from which the camera looks at the place, the cheapest of each distance and roll."""
    station = scene.station
    color_from_tcp = inverse(hand_from_color(station.camera)) @ HAND_FROM_TCP
    side = 1.0 if azimuth_deg > 180.0 else -1.0
    for distance_m, roll_deg in product(_DISTANCES_M, _ROLLS_DEG):
        base_from_tcp = looking_at(center_m, distance_m, tilt_deg, azimuth_deg, side * roll_deg) @ color_from_tcp
        for q_rad, _ in islice(configurations(scene.robot.arm, [base_from_tcp], q_from_rad), _EXAMINED):
            if scene.collision(q_rad, None) is None:
                yield q_rad
                break


def _apart_deg(one: tuple[float, float], other: tuple[float, float]) -> float:
    """Angle between two directions of view, given as (tilt, azimuth) [deg]."""
    a, b = (_direction(*view) for view in (one, other))
    return float(np.degrees(np.arccos(np.clip(a @ b, -1, 1))))


def _direction(tilt_deg: float, azimuth_deg: float) -> Array:
    tilt, azimuth = np.radians([tilt_deg, azimuth_deg])
    return np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)])
