"""Viewpoints of a calibration board: many directions, each reached without collision. Frames: docs/frames.md."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from bus.arrays import Joints, Transform
from bus.errors import CalibrationError
from bus.transforms import from_rotation, inverse
from config.schema import Station
from planning.candidates import configurations
from planning.robot import HAND_FROM_TCP, hand_from_color
from planning.scene import Scene

Array = npt.NDArray[np.float64]

_DISTANCES_M = (0.45, 0.58)
_TILTS_DEG = (0.0, 15.0, 28.0)
_AROUND_DEG = (0.0, 120.0, 240.0, 60.0, 180.0, 300.0)
_ROLLS_DEG = (0.0, 35.0, -35.0)
_EXAMINED = 12


def viewpoints(scene: Scene, station: Station, q_from_rad: Joints) -> list[Joints]:
    """Return ``calibration.poses`` arm configurations (n,), each looking at the board's middle from another direction.

    Args:
        q_from_rad: (joints,) start; each viewpoint is reached from the one before.

    Raises:
        CalibrationError: fewer than 12 can be reached.
    """
    wanted, found = station.calibration.poses, []
    q_rad = q_from_rad
    for base_from_color in islice(_looks(station), 4 * wanted):
        reached = _reached(scene, station, base_from_color, q_rad)
        if reached is not None:
            found.append(reached)
            q_rad = reached
        if len(found) == wanted:
            return found
    if len(found) < 12:
        raise CalibrationError(
            f"The arm reaches only {len(found)} places to look at the board from; 12 are needed.",
            "Lay the board nearer to the middle of the arm's reach and correct calibration.board_center_m.",
        )
    return found


def _looks(station: Station) -> Iterator[Transform]:
    """Yield poses (4, 4) of the colour camera, spread over directions, distances and turns about the optical axis."""
    settings = station.calibration
    center_m = np.array(settings.board_center_m)
    turn = 0
    for around_deg in (*_AROUND_DEG, *(angle + 30.0 for angle in _AROUND_DEG)):
        for tilt_deg in _TILTS_DEG[1:] if turn else _TILTS_DEG:
            distance_m = _DISTANCES_M[turn % len(_DISTANCES_M)]
            roll_deg = _ROLLS_DEG[turn % len(_ROLLS_DEG)]
            turn += 1
            yield looking_at(center_m, distance_m, tilt_deg, around_deg, roll_deg)


def looking_at(center_m: Array, distance_m: float, tilt_deg: float, around_deg: float, roll_deg: float) -> Transform:
    """Return the pose (4, 4) of the colour camera that looks at a place.

    Args:
        center_m: (3,) the place in ``base``. ``tilt_deg``: from the vertical. ``around_deg``: azimuth of the camera
            about the place, 0 on its +x side. ``roll_deg``: about the optical axis.
    """
    # straight down, image up = base x, as from the capture pose
    level = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    tilt = Rotation.from_euler("ZY", [around_deg, tilt_deg], degrees=True).as_matrix()
    untwist = Rotation.from_euler("z", -around_deg, degrees=True).as_matrix()
    roll = Rotation.from_euler("z", roll_deg, degrees=True).as_matrix()
    turned = tilt @ untwist @ level @ roll
    return from_rotation(turned, center_m - distance_m * turned[:, 2])


def _reached(scene: Scene, station: Station, base_from_color: Transform, q_from_rad: Joints) -> Joints | None:
    base_from_tcp = base_from_color @ inverse(hand_from_color(station.camera)) @ HAND_FROM_TCP
    for q_rad, _ in islice(configurations(scene.robot.arm, [base_from_tcp], q_from_rad), _EXAMINED):
        if scene.collision(q_rad, None) is None:
            return q_rad
    return None
