"""Where the wrist camera looks from after the first picture: leaning views, from either side. Frames: docs/frames.md.

Two views at 45 degrees show most of what the view from above hides, and each is half a second away.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import islice

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from benchmarks.heaps.plan import station_of
from bus.errors import DriverError
from bus.transforms import from_rotation, inverse
from config.schema import Station
from planning.candidates import configurations
from planning.motion import move
from planning.robot import HAND_FROM_TCP, Robot, hand_from_color
from planning.scene import Scene

_TILT_DEG, _DISTANCE_M = 45.0, 0.65
_AROUND_DEG = ((120.0, 105.0, 135.0, 90.0, 150.0), (240.0, 255.0, 225.0, 270.0, 210.0))
"""Azimuths of each view, the preferred first; 0 = beyond the pick region, as seen from the base."""
_ROLLS_DEG = (0.0, 90.0, -90.0, 180.0)
_EXAMINED = 12

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Viewpoint:
    """One place to look from.

    Attributes:
        q_rad: (7,) arm configuration. ``base_from_color``: (4, 4) where the station takes the camera to be, there.
        motion_s: planned time from the viewpoint before, the first from the capture pose, among the station's boxes:
            what lies on the table does not count.
    """

    q_rad: Array
    base_from_color: Array
    motion_s: float


@cache
def viewpoints(kind: str) -> tuple[Viewpoint, ...]:
    """Return the further viewpoints over a "table" or a "bin". Raises: DriverError for one out of reach."""
    station = station_of(kind)
    robot = Robot(station)
    scene, q_rad = Scene.of(robot, station), np.array(station.arm.capture_q_rad)
    found = []
    for around_deg in _AROUND_DEG:
        reached = next((q for one in around_deg if (q := _reached(scene, station, one, q_rad)) is not None), None)
        if reached is None:
            raise DriverError(f"No view at an azimuth of {around_deg} degrees is in reach.", "Move the pick region.")
        found.append(Viewpoint(reached, robot.base_from_color(reached), move(scene, q_rad, reached).duration_s))
        q_rad = reached
    return tuple(found)


def _reached(scene: Scene, station: Station, around_deg: float, q_from_rad: Array) -> Array | None:
    """The cheapest free configuration (7,) that looks from there, whatever is up in its picture."""
    tcp_from_color = inverse(HAND_FROM_TCP) @ hand_from_color(station.camera)
    poses = [base_from_color @ inverse(tcp_from_color) for base_from_color in _looks(station, around_deg)]
    for q_rad, _ in islice(configurations(poses, q_from_rad), _EXAMINED):
        if scene.collision(q_rad, station.hand.max_width_m) is None:
            return q_rad
    return None


def _looks(station: Station, around_deg: float) -> list[Array]:
    """Poses (4, 4) of the colour camera, towards the middle of the pick region, one for each roll."""
    x_min, x_max, y_min, y_max = station.scene.pick_region_m
    middle = np.array([(x_min + x_max) / 2, (y_min + y_max) / 2, station.scene.table.top_m])
    down = Rotation.from_euler("x", 180, degrees=True)
    lean = Rotation.from_euler("ZY", [around_deg, _TILT_DEG], degrees=True)
    turns = [lean * down * Rotation.from_euler("z", around_deg + roll, degrees=True) for roll in _ROLLS_DEG]
    return [from_rotation(turn.as_matrix(), middle - _DISTANCE_M * turn.apply([0.0, 0.0, 1.0])) for turn in turns]
