"""Hand-eye calibration: from views of a ChArUco board to where the camera sits in the hand. Pure.

A closed form from the motions between the views starts it; then the re-projection error of all corners in all views is
minimised over both unknown poses, ``hand_from_color`` and ``base_from_board``. (OpenCV 5 has no ``calibrateHandEye``.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from bus.arrays import ColorImage, Transform
from bus.errors import CalibrationError
from bus.messages import CameraModel
from config.calibration import CalibrationSettings

Array = npt.NDArray[np.float64]

FEWEST_CORNERS = 8
FEWEST_VIEWS = 8
_LEAST_TURN_RAD = np.deg2rad(20.0)
_ADVICE = "Look at the board from more sides, with all of it in the picture and well lit."


@dataclass(frozen=True)
class Sighting:
    """The board in one image.

    Attributes:
        base_from_hand: where the hand was. ``board_m``: (n, 3) corners on the board. ``pixels``: (n, 2), distorted.
    """

    base_from_hand: Transform
    board_m: Array
    pixels: Array


@dataclass(frozen=True)
class HandEye:
    """A calibration and how good it is.

    Attributes:
        rms_px: re-projection error over all corners; ``views_px``: of each view.
        spread_mm, spread_deg: how far the board seems to wander between views (root mean square).
    """

    hand_from_color: Transform
    base_from_board: Transform
    rms_px: float
    views_px: tuple[float, ...]
    spread_mm: float
    spread_deg: float


def charuco_board(settings: CalibrationSettings) -> cv2.aruco.CharucoBoard:
    """The board of these settings."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, settings.dictionary))
    return cv2.aruco.CharucoBoard(settings.squares, settings.square_m, settings.marker_m, dictionary)


def board_image(settings: CalibrationSettings, pixels_per_m: float) -> npt.NDArray[np.uint8]:
    """The board as it is printed, without a margin (H, W) grey."""
    width, height = (round(side * pixels_per_m) for side in settings.size_m)
    return np.asarray(charuco_board(settings).generateImage((width, height)))


def sight(color: ColorImage, base_from_hand: Transform, settings: CalibrationSettings) -> Sighting | None:
    """The board's corners in an image as the camera gave it; None when too little of it is seen."""
    board = charuco_board(settings)
    grey = cv2.cvtColor(np.asarray(color), cv2.COLOR_RGB2GRAY)
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(grey)
    if numbers is None or len(numbers) < FEWEST_CORNERS:
        return None
    points = np.asarray(board.getChessboardCorners(), dtype=float)[np.asarray(numbers).ravel()]
    return Sighting(base_from_hand, points, np.asarray(corners, dtype=float).reshape(-1, 2))


def hand_eye(sightings: Sequence[Sighting], camera: CameraModel) -> HandEye:
    """Solve. Raises: CalibrationError: too few views, or from too similar directions."""
    if len(sightings) < FEWEST_VIEWS:
        raise CalibrationError(f"The board was seen in {len(sightings)} views; {FEWEST_VIEWS} are needed.", _ADVICE)
    turns = Rotation.from_matrix(np.array([s.base_from_hand[:3, :3] for s in sightings]))
    turned_rad = max(float((turns[0].inv() * turn).magnitude()) for turn in turns)
    if turned_rad < _LEAST_TURN_RAD:
        raise CalibrationError(
            f"The hand turned by only {np.rad2deg(turned_rad):.0f} degrees between the views.", _ADVICE
        )
    in_color = [_color_from_board(sighting, camera) for sighting in sightings]
    start = _closed_form(sightings, in_color)
    return _refined(sightings, in_color, camera, start)


def off_px(sightings: Sequence[Sighting], camera: CameraModel, hand_from_color: Transform) -> Array:
    """How far (n,) [px] the corners are from where this calibration expects them, the board's place fitted."""
    in_color = [_color_from_board(sighting, camera) for sighting in sightings]
    board = _vector(sightings[0].base_from_hand @ hand_from_color @ in_color[0])

    def errors(vector: Array) -> Array:
        return _errors_px(sightings, camera, hand_from_color, _pose(vector))

    fitted = least_squares(errors, board, x_scale="jac")
    return np.asarray(np.linalg.norm(errors(fitted.x).reshape(-1, 2), axis=1))


def corners_in_color(sighting: Sighting, camera: CameraModel) -> tuple[Array, Array]:
    """Undistorted pixels (n, 2) and depths (n,) [m] of the corners, by the board's pose in this view alone."""
    pose = _color_from_board(sighting, camera)
    points = sighting.board_m @ pose[:3, :3].T + pose[:3, 3]
    matrix, _ = _lens(camera)
    homogeneous = points @ matrix.T
    return homogeneous[:, :2] / homogeneous[:, 2:], points[:, 2]


# --- the two unknown poses --------------------------------------------------------------------------------------------


def _closed_form(sightings: Sequence[Sighting], in_color: Sequence[Transform]) -> Transform:
    """``hand_from_color`` from the motions between views, AX = XB (Park and Martin 1994): the rotation that carries the
    camera's turns onto the hand's, then the translation by least squares."""
    hands, boards = [s.base_from_hand for s in sightings], list(in_color)
    pairs = [(i, j) for i in range(len(hands)) for j in range(i + 1, len(hands))]
    hand_moves = np.array([np.linalg.inv(hands[j]) @ hands[i] for i, j in pairs])
    color_moves = np.array([boards[j] @ np.linalg.inv(boards[i]) for i, j in pairs])
    hand_turns = Rotation.from_matrix(hand_moves[:, :3, :3])
    rotation, _ = Rotation.align_vectors(
        hand_turns.as_rotvec(), Rotation.from_matrix(color_moves[:, :3, :3]).as_rotvec()
    )
    lever = (hand_moves[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    offset = (color_moves[:, :3, 3] @ rotation.as_matrix().T - hand_moves[:, :3, 3]).ravel()
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation.as_matrix(), np.linalg.lstsq(lever, offset)[0]
    return pose


def _refined(
    sightings: Sequence[Sighting], in_color: Sequence[Transform], camera: CameraModel, start: Transform
) -> HandEye:
    board = sightings[0].base_from_hand @ start @ in_color[0]

    def errors(vector: Array) -> Array:
        return _errors_px(sightings, camera, _pose(vector[:6]), _pose(vector[6:]))

    fitted = least_squares(errors, np.concatenate([_vector(start), _vector(board)]), x_scale="jac", loss="soft_l1")
    hand_from_color, base_from_board = _pose(fitted.x[:6]), _pose(fitted.x[6:])
    squared = [
        np.square(_errors_px([sighting], camera, hand_from_color, base_from_board)).reshape(-1, 2).sum(axis=1)
        for sighting in sightings
    ]
    spread_m, spread_rad = _board_spread(sightings, in_color, hand_from_color)
    return HandEye(
        hand_from_color=hand_from_color,
        base_from_board=base_from_board,
        rms_px=float(np.sqrt(np.concatenate(squared).mean())),
        views_px=tuple(float(np.sqrt(one.mean())) for one in squared),
        spread_mm=spread_m * 1e3,
        spread_deg=float(np.rad2deg(spread_rad)),
    )


def _errors_px(
    sightings: Sequence[Sighting], camera: CameraModel, hand_from_color: Transform, base_from_board: Transform
) -> Array:
    """(2 n,) of all corners."""
    errors = []
    for sighting in sightings:
        color_from_board = np.linalg.inv(sighting.base_from_hand @ hand_from_color) @ base_from_board
        vector = _vector(color_from_board)
        expected, _ = cv2.projectPoints(sighting.board_m, vector[:3], vector[3:], *_lens(camera))
        errors.append((expected[:, 0] - sighting.pixels).ravel())
    return np.concatenate(errors)


def _board_spread(
    sightings: Sequence[Sighting], in_color: Sequence[Transform], hand_from_color: Transform
) -> tuple[float, float]:
    """How far the board wanders between views, [m] and [rad]."""
    boards = [s.base_from_hand @ hand_from_color @ pose for s, pose in zip(sightings, in_color, strict=True)]
    places = np.array([board[:3, 3] for board in boards])
    turns = Rotation.from_matrix(np.array([board[:3, :3] for board in boards]))
    wander_m = np.linalg.norm(places - places.mean(axis=0), axis=1)
    return float(np.sqrt(np.mean(wander_m**2))), float(np.sqrt(np.mean((turns.mean().inv() * turns).magnitude() ** 2)))


def _color_from_board(sighting: Sighting, camera: CameraModel) -> Transform:
    found, turn, shift = cv2.solvePnP(sighting.board_m, sighting.pixels, *_lens(camera))
    if not found:
        raise CalibrationError("A view of the board has no pose.", _ADVICE)
    return _pose(np.concatenate([np.ravel(turn), np.ravel(shift)]))


def _lens(camera: CameraModel) -> tuple[Array, Array]:
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    return matrix, np.array(camera.distortion or (0.0,) * 4)


def _pose(vector: Array) -> Transform:
    """From a rotation vector and a position (6,)."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_rotvec(vector[:3]).as_matrix(), vector[3:]
    return pose


def _vector(pose: Transform) -> Array:
    return np.concatenate([Rotation.from_matrix(pose[:3, :3]).as_rotvec(), pose[:3, 3]])
