"""Whether the table leans, or the camera is mounted otherwise than the station says: told from the planes of the views.

A table that leans does so in ``base``, alike in every view; a wrong mounting is alike in the frame ``color`` and shows
another slope and height from each direction. Both are found together, each as small as the planes allow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from bus.transforms import from_rotvec, inverse
from perception.scene.table import Table

_PRIOR = np.array([*np.deg2rad([2.0, 2.0]), 0.005, *np.deg2rad([0.3] * 3), *[0.002] * 3])
"""Standard deviations before anything was seen: the table's slopes and height [m], the mounting's turn and shift [m].
"""
_SLOPE_NOISE_RAD, _HEIGHT_NOISE_M = float(np.deg2rad(0.1)), 0.001
"""Of one view's plane, mostly the camera's systematic error."""
_ROUNDS, _STEP = 4, 1e-6
TABLE_BOUND_RAD, MOUNT_BOUND = float(np.deg2rad(1.0)), 0.82
"""Tilt of the table, and error of the mounting (see `TableOrMount.off_mounting`), beyond which either is named."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TableOrMount:
    """Table and mounting with which the planes of all views agree best.

    Attributes:
        slopes: (2,) of the table along x and y of ``base``. ``height_m``: over the station's, at the given middle.
        color_from_corrected: (4, 4), so that ``base_from_color @ color_from_corrected`` is the better pose.
        deviations: (9,) standard deviations of both slopes, the height [m], the mounting's rotation vector [rad] and
            translation [m].
        named: what is off, "" = neither is.
        tilt_rad: of the table. ``off_mounting``: turn and shift of the mounting together, in standard deviations of a
            calibrated one; the camera's own systematic error looks like 0.2 to 0.7.
    """

    slopes: Array
    height_m: float
    color_from_corrected: Transform
    deviations: Array
    named: Literal["table", "mount", ""]
    tilt_rad: float
    off_mounting: float


def table_or_mount(
    tables: Sequence[Table],
    base_from_color: Sequence[Transform],
    middle_base: Array,
    table_bound_rad: float = TABLE_BOUND_RAD,
    mount_bound: float = MOUNT_BOUND,
) -> TableOrMount:
    """Fit table and mounting to the planes that `perception.scene.table.find_table` found in each view.

    Named is what exceeds its bound, by the larger multiple where both do.

    Args:
        base_from_color: (4, 4) of each view, as believed.
        middle_base: (3,) [m] the middle of the station's table as far as it is looked at.
    """
    seen = [_plane(table, inverse(pose)) for table, pose in zip(tables, base_from_color, strict=True)]
    unknown = np.zeros(9)
    noise = np.tile([_SLOPE_NOISE_RAD, _SLOPE_NOISE_RAD, _HEIGHT_NOISE_M], len(seen))

    def errors(unknown: Array) -> Array:
        """Return what (3 k + 9,) is left to explain, in standard deviations."""
        left = [_left(unknown, plane, pose, middle_base) for plane, pose in zip(seen, base_from_color, strict=True)]
        return np.concatenate([np.concatenate(left) / noise, unknown / _PRIOR])

    for _ in range(_ROUNDS):
        left = errors(unknown)
        jacobian = np.column_stack([(errors(unknown + step) - left) / _STEP for step in _STEP * np.eye(9)])
        covariance = np.linalg.inv(jacobian.T @ jacobian)
        unknown = unknown - covariance @ jacobian.T @ left
    tilt_rad = float(np.arctan(np.hypot(*unknown[:2])))
    off_mounting = float(np.linalg.norm(unknown[3:] / _PRIOR[3:]))
    named = _named(tilt_rad / table_bound_rad, off_mounting / mount_bound)
    return TableOrMount(
        unknown[:2],
        float(unknown[2]),
        from_rotvec(unknown[3:]),
        np.sqrt(np.diag(covariance)),
        named,
        tilt_rad,
        off_mounting,
    )


def _named(table: float, mount: float) -> Literal["table", "mount", ""]:
    """Return what is off, from how many times its bound each is."""
    if max(table, mount) <= 1:
        return ""
    return "table" if table > mount else "mount"


def _plane(table: Table, color_from_base: Transform) -> Array:
    """The plane (4,) normal . p + offset = 0 in ``color``, from one in ``base``."""
    normal = np.array([-table.slope_x, -table.slope_y, 1.0])
    length = np.linalg.norm(normal)
    turned = color_from_base[:3, :3] @ normal / length
    return np.array([*turned, -table.height_m / length - turned @ color_from_base[:3, 3]])


def _left(unknown: Array, plane_color: Array, base_from_color: Transform, middle_base: Array) -> Array:
    """Return how far (3,) the view's plane, mounted thus, is from the table: two slopes, and the height [m] amid."""
    base_from_true = base_from_color @ from_rotvec(unknown[3:])
    normal = base_from_true[:3, :3] @ plane_color[:3]
    offset_m = plane_color[3] - normal @ base_from_true[:3, 3]
    slopes = -normal[:2] / normal[2]
    height_m = -(normal @ middle_base + offset_m) / normal[2]
    return np.array([*(slopes - unknown[:2]), height_m - unknown[2]])
