"""Hand-eye calibration: ``hand_from_color`` from views of a ChArUco board. Pure. Frames: docs/frames.md.

A closed form from the motions between the views is the start; then the re-projection error of all corners in all views
is minimised over the two unknown poses, ``hand_from_color`` and ``base_from_board``. (OpenCV 5 has no
``calibrateHandEye``.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy.optimize import approx_fprime, least_squares
from scipy.spatial.transform import Rotation

from bus.arrays import ColorImage, Transform
from bus.errors import CalibrationError
from bus.messages import CameraModel
from bus.transforms import apply, from_rotation, from_rotvec, inverse, to_rotvec
from config.calibration import CalibrationSettings
from config.charuco import charuco_board

Array = npt.NDArray[np.float64]

FEWEST_CORNERS = 8
FEWEST_VIEWS = 8
_LEAST_TURN_RAD = np.deg2rad(5.0)
"""Least turn of the hand about a second axis between the views (root mean square over all pairs). With turns about one
axis only, the camera's position along it is unobservable; just above that, half a pixel corresponds to millimetres."""
_HALF_TURN_RAD = np.deg2rad(175.0)
"""Turns of nearly 180 degrees are left out: their axis has no definite sign, and a wrong one would reverse the camera.
"""
_WORST_MM, _WORST_DEG = 1.5, 0.3
"""A mounting that is less certain is refused: at arm's length 0.3 degrees are 2.5 mm."""
_STEP = 1e-6
_ADVICE = "Look at the board from more sides, with all of it in the picture and well lit."


@dataclass(frozen=True)
class Sighting:
    """The board in one image.

    Attributes:
        base_from_hand: (4, 4) pose of the hand at the exposure.
        board_m: (n, 3) corners in the board's frame. ``pixels``: (n, 2) = (u, v), distorted.
    """

    base_from_hand: Transform
    board_m: Array
    pixels: Array


@dataclass(frozen=True)
class HandEye:
    """A calibration and its quality.

    Attributes:
        hand_from_color, base_from_board: (4, 4).
        rms_px: re-projection error over all corners; ``views_px``: of each view.
        spread_mm, spread_deg: scatter of the board's pose between views (root mean square).
        uncertainty_mm, uncertainty_deg: of ``hand_from_color``, one standard deviation over all directions.
    """

    hand_from_color: Transform
    base_from_board: Transform
    rms_px: float
    views_px: tuple[float, ...]
    spread_mm: float
    spread_deg: float
    uncertainty_mm: float
    uncertainty_deg: float


def sight(color: ColorImage, base_from_hand: Transform, settings: CalibrationSettings) -> Sighting | None:
    """Find the board's corners in a raw, distorted image; None for fewer than 8 corners.

    Args:
        color: (H, W, 3) RGB. ``base_from_hand``: (4, 4) pose of the hand at the exposure.
    """
    board = charuco_board(settings)
    grey = cv2.cvtColor(np.asarray(color), cv2.COLOR_RGB2GRAY)
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(grey)
    if numbers is None or len(numbers) < FEWEST_CORNERS:
        return None
    points = np.asarray(board.getChessboardCorners(), dtype=float)[np.asarray(numbers).ravel()]
    return Sighting(base_from_hand, points, np.asarray(corners, dtype=float).reshape(-1, 2))


def hand_eye(sightings: Sequence[Sighting], camera: CameraModel) -> HandEye:
    """Solve for the mounting of the camera.

    Raises: CalibrationError for fewer than 8 views, views from too similar directions, or too uncertain a result.
    """
    if len(sightings) < FEWEST_VIEWS:
        raise CalibrationError(f"The board was seen in {len(sightings)} views; {FEWEST_VIEWS} are needed.", _ADVICE)
    return _solved(sightings, camera, None)


def corrected(sightings: Sequence[Sighting], camera: CameraModel, hand_from_color: Transform) -> HandEye:
    """Solve for the mounting from possibly few views, starting at ``hand_from_color`` (4, 4), which is nearly right.

    Raises: CalibrationError for views from too similar directions, or too uncertain a result.
    """
    return _solved(sightings, camera, hand_from_color)


def _solved(sightings: Sequence[Sighting], camera: CameraModel, start: Transform | None) -> HandEye:
    _require_turns(sightings)
    in_color = [_color_from_board(sighting, camera) for sighting in sightings]
    found = _refined(sightings, in_color, camera, _closed_form(sightings, in_color) if start is None else start)
    _require_certain(found)
    return found


def _require_turns(sightings: Sequence[Sighting]) -> None:
    """Raises: CalibrationError unless the hand turned about two axes between the views."""
    hands = np.array([sighting.base_from_hand[:3, :3] for sighting in sightings])
    first, second = np.triu_indices(len(hands), k=1)
    turns_rad = Rotation.from_matrix(np.swapaxes(hands[second], 1, 2) @ hands[first]).as_rotvec()
    turns_rad[np.linalg.norm(turns_rad, axis=1) > _HALF_TURN_RAD] = 0.0
    about_rad = np.linalg.svd(turns_rad, compute_uv=False) / np.sqrt(max(1, len(turns_rad)))
    turned_rad = float(about_rad[1]) if len(about_rad) > 1 else 0.0
    if turned_rad < _LEAST_TURN_RAD:
        raise CalibrationError(
            f"Between the views the hand turned by only {np.rad2deg(turned_rad):.1f} degrees about a second axis; "
            f"{np.rad2deg(_LEAST_TURN_RAD):.0f} are needed.",
            _ADVICE,
        )


def off_px(sightings: Sequence[Sighting], camera: CameraModel, hand_from_color: Transform) -> Array:
    """Distance (n,) [px] of the corners from their expected pixels under this calibration, the board's pose fitted."""
    in_color = [_color_from_board(sighting, camera) for sighting in sightings]
    board = to_rotvec(sightings[0].base_from_hand @ hand_from_color @ in_color[0])

    def errors(vector: Array) -> Array:
        return _errors_px(sightings, camera, hand_from_color, from_rotvec(vector))

    fitted = least_squares(errors, board, x_scale="jac")
    return np.asarray(np.linalg.norm(errors(fitted.x).reshape(-1, 2), axis=1))


def corners_in_color(sighting: Sighting, camera: CameraModel) -> tuple[Array, Array]:
    """Undistorted pixels (n, 2) and depths (n,) [m] of the corners, by the board's pose in this view alone."""
    pose = _color_from_board(sighting, camera)
    points = apply(pose, sighting.board_m)
    matrix, _ = _lens(camera)
    homogeneous = points @ matrix.T
    return homogeneous[:, :2] / homogeneous[:, 2:], points[:, 2]


# --- the two unknown poses --------------------------------------------------------------------------------------------


def _closed_form(sightings: Sequence[Sighting], in_color: Sequence[Transform]) -> Transform:
    """``hand_from_color`` from the motions between views, AX = XB (Park and Martin 1994).

    The rotation maps the camera's turns onto the hand's; the translation follows by least squares.
    """
    hands, boards = [s.base_from_hand for s in sightings], list(in_color)
    pairs = [(i, j) for i in range(len(hands)) for j in range(i + 1, len(hands))]
    hand_moves = np.array([inverse(hands[j]) @ hands[i] for i, j in pairs])
    color_moves = np.array([boards[j] @ inverse(boards[i]) for i, j in pairs])
    hand_turns = Rotation.from_matrix(hand_moves[:, :3, :3])
    color_turns = Rotation.from_matrix(color_moves[:, :3, :3])
    told = np.maximum(hand_turns.magnitude(), color_turns.magnitude()) < _HALF_TURN_RAD
    rotation, _ = Rotation.align_vectors(hand_turns[told].as_rotvec(), color_turns[told].as_rotvec())
    lever = (hand_moves[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    offset = (color_moves[:, :3, 3] @ rotation.as_matrix().T - hand_moves[:, :3, 3]).ravel()
    return from_rotation(rotation.as_matrix(), np.linalg.lstsq(lever, offset)[0])


def _refined(
    sightings: Sequence[Sighting], in_color: Sequence[Transform], camera: CameraModel, start: Transform
) -> HandEye:
    board = sightings[0].base_from_hand @ start @ in_color[0]

    def errors(vector: Array) -> Array:
        return _errors_px(sightings, camera, from_rotvec(vector[:6]), from_rotvec(vector[6:]))

    fitted = least_squares(errors, np.concatenate([to_rotvec(start), to_rotvec(board)]), x_scale="jac", loss="soft_l1")
    hand_from_color, base_from_board = from_rotvec(fitted.x[:6]), from_rotvec(fitted.x[6:])
    uncertain_m, uncertain_rad = _uncertainty(sightings, camera, hand_from_color, base_from_board)
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
        uncertainty_mm=uncertain_m * 1e3,
        uncertainty_deg=float(np.rad2deg(uncertain_rad)),
    )


def _require_certain(found: HandEye) -> None:
    if not (found.uncertainty_mm <= _WORST_MM and found.uncertainty_deg <= _WORST_DEG):
        raise CalibrationError(
            f"The views leave the camera's place uncertain by {found.uncertainty_mm:.1f} mm and "
            f"{found.uncertainty_deg:.2f} degrees; {_WORST_MM} mm and {_WORST_DEG} degrees are allowed.",
            _ADVICE,
        )


def _uncertainty(
    sightings: Sequence[Sighting], camera: CameraModel, hand_from_color: Transform, base_from_board: Transform
) -> tuple[float, float]:
    """Standard deviations [m] and [rad] of ``hand_from_color``: the change when one view is left out (jackknife).

    Corner errors within a view are correlated when the arm's pose is inaccurate, so a corner-wise estimate is too
    small; it serves as the lower bound.
    """

    def errors(vector: Array) -> Array:
        return _errors_px(
            sightings, camera, hand_from_color @ from_rotvec(vector[:6]), base_from_board @ from_rotvec(vector[6:])
        )

    left_px, slope = errors(np.zeros(12)), approx_fprime(np.zeros(12), errors, _STEP)
    trust = (1.0 + left_px**2) ** -0.25  # weights of the robust fit
    left_px, slope = left_px * trust, slope * trust[:, None]
    normal = slope.T @ slope
    rows = np.cumsum([2 * len(sighting.pixels) for sighting in sightings])[:-1]
    parts = zip(np.split(slope, rows), np.split(left_px, rows), strict=True)
    try:
        least = np.linalg.inv(normal) * (left_px @ left_px) / max(1, len(left_px) - 12)
        carried = np.array([np.linalg.solve(normal - part.T @ part, part.T @ left) for part, left in parts])
    except np.linalg.LinAlgError:
        return float("inf"), float("inf")
    count = len(sightings)
    variance = np.maximum(np.diag(least), (count - 1) / count * np.square(carried).sum(axis=0))
    return float(np.sqrt(variance[3:6].sum())), float(np.sqrt(variance[:3].sum()))


def _errors_px(
    sightings: Sequence[Sighting], camera: CameraModel, hand_from_color: Transform, base_from_board: Transform
) -> Array:
    """Re-projection errors (2 n,) [px] of all corners."""
    errors = []
    for sighting in sightings:
        color_from_board = inverse(sighting.base_from_hand @ hand_from_color) @ base_from_board
        vector = to_rotvec(color_from_board)
        expected, _ = cv2.projectPoints(sighting.board_m, vector[:3], vector[3:], *_lens(camera))
        errors.append((expected[:, 0] - sighting.pixels).ravel())
    return np.concatenate(errors)


def _board_spread(
    sightings: Sequence[Sighting], in_color: Sequence[Transform], hand_from_color: Transform
) -> tuple[float, float]:
    """Scatter of the board's pose between views, [m] and [rad]."""
    boards = [s.base_from_hand @ hand_from_color @ pose for s, pose in zip(sightings, in_color, strict=True)]
    places = np.array([board[:3, 3] for board in boards])
    turns = Rotation.from_matrix(np.array([board[:3, :3] for board in boards]))
    wander_m = np.linalg.norm(places - places.mean(axis=0), axis=1)
    return float(np.sqrt(np.mean(wander_m**2))), float(np.sqrt(np.mean((turns.mean().inv() * turns).magnitude() ** 2)))


def _color_from_board(sighting: Sighting, camera: CameraModel) -> Transform:
    found, turn, shift = cv2.solvePnP(sighting.board_m, sighting.pixels, *_lens(camera))
    if not found:
        raise CalibrationError("A view of the board has no pose.", _ADVICE)
    return from_rotvec(np.concatenate([np.ravel(turn), np.ravel(shift)]))


def _lens(camera: CameraModel) -> tuple[Array, Array]:
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    return matrix, np.array(camera.distortion or (0.0,) * 4)
