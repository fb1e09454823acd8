"""A grasp drawn into an image: both fingers as boxes at the opening of the approach, and the line they close along."""

from __future__ import annotations

import itertools

import cv2
import numpy as np
import numpy.typing as npt

from bus.messages import CameraModel, Grasp
from bus.transforms import apply
from config.devices import HandSettings
from config.franka_hand import FINGER_LENGTH_M, FINGER_TIP_M
from perception.geometry.lift import project

_FINGER, _CLOSING, _CONTACT = (230, 30, 30), (60, 255, 60), (255, 255, 255)
_OPAQUE = 0.25
_NEAREST_M = 0.02
_CORNERS = np.array(list(itertools.product((-1.0, 1.0), (-1.0, 1.0), (-1.0, 1.0))))
_EDGES = [(a, b) for a, b in itertools.combinations(range(8), 2) if np.abs(_CORNERS[a] - _CORNERS[b]).sum() == 2]

Image = npt.NDArray[np.uint8]
Array = npt.NDArray[np.float64]


def draw_jaw(image: Image, grasp: Grasp, color_from_base: Array, camera: CameraModel, hand: HandSettings) -> Image:
    """A copy of the image (H, W, 3) with the jaw: fingers red, the line between the contacts green.

    Args:
        color_from_base: (4, 4). ``camera``: of the image, without distortion.
    """
    drawn, shade = image.copy(), image.copy()
    color_from_tcp = color_from_base @ grasp.base_from_tcp
    for side in (-1.0, 1.0):
        corners = apply(color_from_tcp, _finger(side, grasp.opening_m, hand))
        if corners[:, 2].min() < _NEAREST_M:  # a finger that reaches past the camera has no outline
            continue
        corners_px = np.rint(project(corners, camera)).astype(np.int32)
        cv2.fillConvexPoly(shade, cv2.convexHull(corners_px), _FINGER)
        for a, b in _EDGES:
            cv2.line(drawn, corners_px[a].tolist(), corners_px[b].tolist(), _FINGER, 1, cv2.LINE_AA)
    contacts = apply(color_from_tcp, np.array([[0, -grasp.width_m / 2, 0], [0, grasp.width_m / 2, 0]]))
    start, end = np.rint(project(contacts, camera)).astype(int).tolist()
    cv2.line(drawn, start, end, _CLOSING, 2, cv2.LINE_AA)
    for point in (start, end):
        cv2.circle(drawn, point, 3, _CONTACT, -1, cv2.LINE_AA)
    return np.asarray(cv2.addWeighted(shade, _OPAQUE, drawn, 1 - _OPAQUE, 0), dtype=np.uint8)


def _finger(side: float, opening_m: float, hand: HandSettings) -> Array:
    """Corners (8, 3) [m] of one finger in the tcp's frame: x across, y along the closing axis, z the approach."""
    half_m = np.array([hand.finger_width_m, hand.finger_thickness_m, FINGER_LENGTH_M]) / 2
    middle_m = np.array([0.0, side * (opening_m + hand.finger_thickness_m) / 2, FINGER_TIP_M - FINGER_LENGTH_M / 2])
    return np.asarray(middle_m + _CORNERS * half_m)
