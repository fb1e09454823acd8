"""The views of the wrist camera after the first picture: the product's own viewpoints. Frames: docs/frames.md."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from benchmarks.heaps.plan import station_of
from bus.transforms import direction_of_view_deg
from config.scene import scene_boxes
from planning.looks import next_look, unseen
from planning.robot import Robot
from planning.scene import Scene

_VIEWS = 2

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Viewpoint:
    """One place to look from.

    Attributes:
        q_rad: (7,) arm configuration. ``base_from_color``: (4, 4) where the station takes the camera to be, there.
        motion_s: planned time from the viewpoint before, the first from the capture pose.
    """

    q_rad: Array
    base_from_color: Array
    motion_s: float


@cache
def viewpoints(kind: str) -> tuple[Viewpoint, ...]:
    """Return the further viewpoints over a "table" or a "bin". Raises: CycleFailure for one out of reach."""
    station = station_of(kind)
    robot = Robot(station)
    scene = Scene.of(robot, station, boxes=(*scene_boxes(station.scene), unseen(station)))
    q_rad = np.array(station.arm.capture_q_rad)
    taken, found = [direction_of_view_deg(robot.base_from_color(q_rad))], []
    for _ in range(_VIEWS):
        one = next_look(scene, q_rad, taken)
        q_rad = one.motion.end_q_rad
        taken.append((one.tilt_deg, one.azimuth_deg))
        found.append(Viewpoint(q_rad, robot.base_from_color(q_rad), one.motion.duration_s))
    return tuple(found)
