"""The Femto Mega's two lenses: intrinsics, distortion, and the maps that distort MuJoCo's pinhole images.

Intrinsics are plausible figures for an NFOV unbinned 640x576 depth and a 1280x720 colour stream; no unit's calibration
is published. Distortion is OpenCV's rational model (k1, k2, p1, p2, k3, k4, k5, k6); frames: docs/frames.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from bus.messages import CameraModel
from bus.transforms import from_rotation, from_wxyz
from config.schema import Station
from config.simulation import SimSettings

COLOR = CameraModel(
    width=1280, height=720, fx=746.5, fy=746.3, cx=640.4, cy=361.2,
    distortion=(0.078, -0.107, 0.0, 0.0, 0.044, 0.0, 0.0, 0.0),
)  # fmt: skip
DEPTH = CameraModel(
    width=640, height=576, fx=504.6, fy=504.7, cx=321.2, cy=333.4,
    distortion=(19.2, 11.9, 0.0, 0.0, 0.59, 19.6, 17.6, 3.2),
)  # fmt: skip
_RADII = 4097


COLOR_FROM_DEPTH = from_rotation(Rotation.from_euler("x", 6.0, degrees=True).as_matrix(), (-0.032, -0.002, 0.004))
"""Lens spacing 32 mm, the depth lens tilted by 6 degrees about x."""


@dataclass(frozen=True)
class Pinhole:
    """The wider, centred, undistorted image that is rendered, and the map that distorts it into the lens's image.

    Attributes:
        width, height, focal_px: of the rendered image [px].
        source_x, source_y: (H, W) of the lens's image: the pixel in the rendered image for each of its pixels.
    """

    width: int
    height: int
    focal_px: float
    source_x: npt.NDArray[np.float32]
    source_y: npt.NDArray[np.float32]

    @property
    def fovy_deg(self) -> float:
        """Vertical field of view of the rendered image."""
        return float(np.rad2deg(2 * np.arctan(self.height / 2 / self.focal_px)))


def _pinhole(camera: CameraModel, finer: float, margin_px: int = 4) -> Pinhole:
    """Return the smallest centred pinhole that covers every ray of ``camera``, ``finer`` times as fine as it."""
    x, y = np.meshgrid(
        (np.arange(camera.width) - camera.cx) / camera.fx, (np.arange(camera.height) - camera.cy) / camera.fy
    )
    stretch = _stretch(camera, np.hypot(x, y))
    focal_px = finer * camera.fx
    x_px, y_px = x * stretch * focal_px, y * stretch * focal_px
    width, height = (2 * (int(np.ceil(np.abs(side_px).max())) + margin_px) for side_px in (x_px, y_px))
    source_x, source_y = x_px + (width - 1) / 2, y_px + (height - 1) / 2
    return Pinhole(width, height, focal_px, source_x.astype(np.float32), source_y.astype(np.float32))


def _stretch(camera: CameraModel, radius: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the ratio of undistorted to distorted radius for each image radius; for radial distortion only.

    Solved for some radii, with a spline between them (to 1e-11): for every pixel it would take most of a second.
    """
    assert camera.distortion[2:4] == (0.0, 0.0), "a tangential distortion depends on more than the radius"
    some = np.linspace(0.0, radius.max(), _RADII)
    points = np.stack([some, np.zeros_like(some)], axis=1)[:, None]
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-12)
    rays = cv2.undistortPoints(points, np.eye(3), np.array(camera.distortion), criteria=criteria)[:, 0, 0]
    ratio = np.ones_like(some)  # on the axis
    ratio[1:] = rays[1:] / some[1:]
    return np.asarray(CubicSpline(some, ratio)(radius))


COLOR_PINHOLE = _pinhole(COLOR, 1.0)
DEPTH_PINHOLE = _pinhole(DEPTH, 2.0)  # finer, because its pixels are picked and not blended: depths must not mix
FOVY_DEG = {"color": COLOR_PINHOLE.fovy_deg, "depth": DEPTH_PINHOLE.fovy_deg}


def _mounting_error(sim: SimSettings) -> npt.NDArray[np.float64]:
    """Return the error transform, in a direction and about an axis drawn from the seed."""
    shift, axis = np.random.default_rng([sim.seed % 2**64, 5]).normal(size=(2, 3))
    turn_rad = np.deg2rad(sim.mounting_error_deg) * axis / np.linalg.norm(axis)
    shift_m = sim.mounting_error_mm / 1e3 * shift / np.linalg.norm(shift)
    return from_rotation(Rotation.from_rotvec(turn_rad).as_matrix(), shift_m)


def hand_from_cameras(station: Station) -> dict[str, npt.NDArray[np.float64]]:
    """Return the poses (4, 4) [m] of both lenses in the hand, from the colour lens's mounting and its error."""
    mounting = from_wxyz(station.camera.hand_from_color_wxyz, station.camera.hand_from_color_position_m)
    hand_from_color = mounting @ _mounting_error(station.sim)
    return {"color": hand_from_color, "depth": hand_from_color @ COLOR_FROM_DEPTH}
