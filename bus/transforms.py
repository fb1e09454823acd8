"""Poses as 4x4 matrices: ``a_from_b`` maps coordinates in b to coordinates in a (docs/frames.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from bus.lazy import LazyModule

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Array = npt.NDArray[np.float64]
else:
    np: Any = LazyModule("numpy")
spatial: Any = LazyModule("scipy.spatial.transform")

UNIT_TOLERANCE = 1e-3
"""Allowed deviation of a quaternion's length from 1: it may be typed by hand or sent in single precision."""
_ORIGIN = (0.0, 0.0, 0.0)


def unit_wxyz(wxyz: Sequence[float] | Array) -> Array:
    """Return the quaternion (4,) scaled to length 1. Raises: ValueError for another shape, or a length far from 1."""
    quaternion = np.asarray(wxyz, dtype=np.float64)
    if quaternion.shape != (4,):
        raise ValueError(f"a quaternion is the 4 numbers w, x, y, z, not {quaternion.size}")
    length = math.hypot(*quaternion.tolist())  # hypot does not overflow
    if not abs(length - 1.0) <= UNIT_TOLERANCE:  # written so that NaN fails
        raise ValueError(f"a rotation is a quaternion w, x, y, z of length 1; this one's is {length:.4g}")
    w, x, y, z = quaternion
    return np.asarray(quaternion / np.sqrt(x * x + y * y + z * z + w * w))


def from_wxyz(wxyz: Sequence[float] | Array, translation: Sequence[float] | Array = _ORIGIN) -> Array:
    """Return the pose (4, 4) of a unit quaternion w, x, y, z and a translation (3,) [m].

    Raises:
        ValueError: the quaternion's length is not 1, or a number is not finite.
    """
    w, x, y, z = unit_wxyz(wxyz)
    rotation = np.array(
        [
            [x * x - y * y - z * z + w * w, 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), -x * x + y * y - z * z + w * w, 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), -x * x - y * y + z * z + w * w],
        ]
    )
    return from_rotation(rotation, translation)


def from_rotation(rotation: Array, translation: Sequence[float] | Array = _ORIGIN) -> Array:
    """Return the pose (4, 4) of a rotation matrix (3, 3) and a translation (3,) [m]. Raises: ValueError: not finite."""
    transform = affine(rotation, translation)
    if not np.isfinite(transform).all():
        raise ValueError("a pose has finite numbers only")
    return transform


def from_translation(translation: Sequence[float] | Array) -> Array:
    """Return the pose (4, 4) of a translation (3,) [m] alone. Raises: ValueError: not finite."""
    return from_rotation(np.eye(3), translation)


def affine(matrix: Array, translation: Sequence[float] | Array) -> Array:
    """Return the map (4, 4) of any matrix (3, 3) - it may scale, mirror, hold NaN - and a translation (3,) [m]."""
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = matrix, translation
    return transform


def to_wxyz(transform: Array) -> tuple[float, float, float, float]:
    """Return a pose's rotation as a unit quaternion w, x, y, z, the one of the two with w >= 0."""
    turn = spatial.Rotation.from_matrix(transform[:3, :3])
    w, x, y, z = turn.as_quat(scalar_first=True, canonical=True).tolist()
    return w, x, y, z


def from_rotvec(vector: Array) -> Array:
    """Return the pose (4, 4) of a rotation vector [rad] and a translation [m], together (6,)."""
    return from_rotation(spatial.Rotation.from_rotvec(vector[:3]).as_matrix(), vector[3:])


def to_rotvec(transform: Array) -> Array:
    """Return a pose's rotation vector [rad] and translation [m], together (6,)."""
    turn = spatial.Rotation.from_matrix(transform[:3, :3])
    return np.concatenate([turn.as_rotvec(), transform[:3, 3]])


def angle_between_rad(one: Array, other: Array) -> float:
    """Return the angle [rad] between the orientations of two poses (4, 4); NaN when a rotation holds NaN."""
    # The Frobenius distance is 2 sqrt(2) sin(angle / 2): exact near zero, where arccos of the trace is not.
    chord = float(np.linalg.norm(one[:3, :3] - other[:3, :3])) / (2 * math.sqrt(2))
    return chord if math.isnan(chord) else 2 * math.asin(min(1.0, chord))


def inverse(transform: Array) -> Array:
    """Return ``b_from_a`` of the pose ``a_from_b`` (4, 4), by transposing its rotation; no linear solve."""
    back = transform[:3, :3].T
    return from_rotation(back, -back @ transform[:3, 3])


def apply(transform: Array, points: Array) -> Array:
    """Map points (..., 3) from b to a with ``a_from_b`` (4, 4)."""
    return np.asarray(points @ transform[:3, :3].T + transform[:3, 3])


def direction_of_view_deg(base_from_camera: Array) -> tuple[float, float]:
    """Return from where a camera (4, 4) looks: tilt from the vertical, and azimuth; 0 is the +x side of ``base``."""
    x, y, z = -base_from_camera[:3, 2]
    return float(np.degrees(np.arccos(np.clip(z, -1, 1)))), float(np.degrees(np.arctan2(y, x)) % 360)
