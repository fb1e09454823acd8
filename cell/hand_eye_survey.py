"""Views the calibration board from many sides, and finds or checks ``hand_from_color``. Frames: docs/frames.md."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bus.arrays import Joints, Transform
from bus.errors import CalibrationError, NotConnected, StaleFrame
from bus.messages import Frame, Observation
from bus.transforms import angle_between_rad
from cell.pick.capture import capture
from config.schema import Station
from drivers.interface import Arm, Camera, Devices
from perception.fusion.agreed import disagreement
from perception.geometry.depth import register
from perception.hand_eye import HandEye, Sighting, corners_in_color, corrected, hand_eye, off_px, sight
from perception.scene.look import Look
from planning.motion import move
from planning.robot import Robot, hand_from_color
from planning.scene import Scene
from planning.viewpoints import viewpoints

_CHECKED_FROM = 5
_AT_RAD = 1e-3
Say = Callable[[str], None]


@dataclass(frozen=True)
class Check:
    """The deviation of the board's corners under the present calibration.

    Attributes:
        off_px: root mean square; ``worst_px``: of one corner.
        off_mm: the root mean square at the board's distance.
        moved_mm, moved_deg: the camera's offset from the present calibration, estimated from these few views.
        uncertainty_mm, uncertainty_deg: of that offset, one standard deviation.
        depth_off_mm: mean difference of measured and expected depth at the board; NaN = no depth there.
        disagree_mm: median distance between the surfaces that the looks show, as in a pick with several looks; with
            ``disagree_after_mm`` if the camera sat otherwise by ``looks_mm``, ``looks_deg``. None = nothing in common.
    """

    off_px: float
    worst_px: float
    off_mm: float
    moved_mm: float
    moved_deg: float
    uncertainty_mm: float
    uncertainty_deg: float
    depth_off_mm: float
    disagree_mm: float | None
    disagree_after_mm: float | None
    looks_mm: float
    looks_deg: float


class Surveyor:
    """Moves the arm around the board. All motions are planned among the station's boxes and guarded as in a pick.

    Args:
        say: called with each line of progress.

    Raises: NotConnected without an arm or a camera.
    """

    def __init__(self, devices: Devices, robot: Robot, station: Station, say: Say) -> None:
        if devices.arm is None or devices.camera is None:
            raise NotConnected("Calibration needs an arm and a camera.", "Check `serves` in the station file.")
        self._arm: Arm = devices.arm
        self._camera: Camera = devices.camera
        self._robot, self._station, self._say = robot, station, say
        self._scene = Scene.of(robot, station)

    def calibrate(self) -> HandEye:
        """Calibrate. Raises: CalibrationError for too few views, or a residual beyond `calibration.max_rms_px`."""
        sightings, looks = self._look_around(self._viewpoints())
        frames = [look.frame for look in looks]
        found = hand_eye(sightings, frames[0].color_camera)
        most_px = self._station.calibration.max_rms_px
        if found.rms_px > most_px:
            raise CalibrationError(
                f"The corners do not fit: {found.rms_px:.2f} px root mean square, allowed are {most_px:.2f}.",
                "Is calibration.square_m what you measure on the print, the board flat, and the camera screwed tight?",
            )
        return found

    def check(self) -> Check:
        """Check the present calibration. Raises: CalibrationError when the board is not seen, or from too few sides."""
        vantage_q_rad = self._viewpoints()
        chosen = vantage_q_rad[:: max(1, len(vantage_q_rad) // _CHECKED_FROM)]
        sightings, looks = self._look_around(chosen)
        frames = [look.frame for look in looks]
        if not sightings:
            raise CalibrationError(
                "The board was not seen.",
                "Lay it where calibration.board_center_m says; in a simulated cell: --set sim.board=true.",
            )
        camera, mounting = frames[0].color_camera, hand_from_color(self._station.camera)
        found = corrected(sightings, camera, mounting)
        moved_mm, moved_deg = moved(mounting, found.hand_from_color)
        off = off_px(sightings, camera, mounting)
        rms_px = float(np.sqrt(np.mean(off**2)))
        mount = disagreement([Look.of(look, self._station) for look in looks], self._station)
        looks_mm, looks_deg = moved(np.eye(4), mount.color_from_corrected)
        return Check(
            off_px=rms_px,
            worst_px=float(off.max()),
            off_mm=rms_px / camera.fx * _distance_m(sightings, mounting, self._station) * 1e3,
            moved_mm=moved_mm,
            moved_deg=moved_deg,
            uncertainty_mm=found.uncertainty_mm,
            uncertainty_deg=found.uncertainty_deg,
            depth_off_mm=_depth_off_mm(frames, sightings),
            disagree_mm=1e3 * mount.residual_before_m if mount.pairs else None,
            disagree_after_mm=1e3 * mount.residual_after_m if mount.pairs else None,
            looks_mm=looks_mm,
            looks_deg=looks_deg,
        )

    def _viewpoints(self) -> list[Joints]:
        return viewpoints(self._scene, self._station, self._arm.state().q_rad)

    def _look_around(self, vantage_q_rad: Sequence[Joints]) -> tuple[list[Sighting], list[Observation]]:
        """The sightings of all viewpoints, and what was observed there; returns to the start at the end."""
        sightings: list[Sighting] = []
        looks: list[Observation] = []
        for number, q_rad in enumerate(vantage_q_rad, start=1):
            self._go(q_rad)
            seen = capture(self._camera, self._arm, self._robot)
            hand = self._robot.base_from_hand(seen.view.q_rad)
            sighting = sight(seen.frame.color, hand, self._station.calibration)
            corners = len(sighting.pixels) if sighting is not None else 0
            self._say(f"  view {number:>2} of {len(vantage_q_rad)}: {corners or 'too few'} corners")
            if sighting is not None:
                sightings.append(sighting)
                looks.append(seen)
        self._go(np.array(self._station.arm.capture_q_rad))
        return sightings, looks

    def _go(self, q_rad: Joints) -> None:
        now_q_rad = self._arm.state().q_rad
        if np.abs(now_q_rad - q_rad).max() < _AT_RAD:
            return
        if not self._arm.execute(move(self._scene, now_q_rad, q_rad)).finished:
            raise StaleFrame("Stopped on the way.", "Nothing was changed.")


def moved(old: Transform, new: Transform) -> tuple[float, float]:
    """Distance between two poses (4, 4): [mm] and [deg]."""
    return float(np.linalg.norm(new[:3, 3] - old[:3, 3]) * 1e3), math.degrees(angle_between_rad(old, new))


def _distance_m(sightings: Sequence[Sighting], mounting: Transform, station: Station) -> float:
    eyes = [(sighting.base_from_hand @ mounting)[:3, 3] for sighting in sightings]
    return float(np.mean([np.linalg.norm(eye - station.calibration.board_center_m) for eye in eyes]))


def _depth_off_mm(frames: Sequence[Frame], sightings: Sequence[Sighting]) -> float:
    """Measured minus expected depth [mm], over the board's corners in all views; NaN where the camera is too close."""
    off_m = []
    for frame, sighting in zip(frames, sightings, strict=True):
        pixels, expected_m = corners_in_color(sighting, frame.color_camera)
        u, v = np.rint(pixels).astype(int).T
        off_m.append(register(frame).depth_m[v, u] - expected_m)
    measured_m = np.concatenate(off_m)
    measured_m = measured_m[np.isfinite(measured_m)]
    return float(measured_m.mean() * 1e3) if len(measured_m) else float("nan")
