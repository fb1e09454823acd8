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
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rotation, translation
    if not np.isfinite(transform).all():
        raise ValueError("a pose has finite numbers only")
    return transform


def inverse(transform: Array) -> Array:
    """Return ``b_from_a`` of the pose ``a_from_b`` (4, 4), by transposing its rotation; no linear solve."""
    back = transform[:3, :3].T
    return from_rotation(back, -back @ transform[:3, 3])


def apply(transform: Array, points: Array) -> Array:
    """Map points (..., 3) from b to a with ``a_from_b`` (4, 4)."""
    return np.asarray(points @ transform[:3, :3].T + transform[:3, 3])
