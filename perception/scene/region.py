"""The pick region: which points lie in it, and which of them may belong to an object. In ``base``."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from config.scene import scene_boxes
from config.schema import Station

_BESIDE_M = 0.08
"""An object that reaches into the pick region is seen whole when it ends within this distance."""
_FIXTURE_M = 0.012
"""Points so near a box of the station are that box: depth noise, edges, a table that lies a little elsewhere."""

Mask = npt.NDArray[np.bool_]
Points = npt.NDArray[np.float32]


def within(points_base: Points, station: Station, beside_m: float = 0.0) -> Mask:
    """Return the points (..., 3) above or below the pick region, or at most ``beside_m`` beside it."""
    x_min, x_max, y_min, y_max = station.scene.pick_region_m
    x, y = points_base[..., 0], points_base[..., 1]
    inside = (x > x_min - beside_m) & (x < x_max + beside_m) & (y > y_min - beside_m) & (y < y_max + beside_m)
    return np.asarray(inside)


def raised(points_base: Points, height_m: npt.NDArray[np.float32], station: Station) -> Mask:
    """Return the points (h, w) that rise above the table in and around the pick region and belong to no known box.

    Args:
        height_m: (h, w) above the seen table. What rises above ``scene.max_height_m`` is no object.
    """
    found = (height_m > station.perception.min_object_height_m) & (height_m < station.scene.max_height_m)
    at = np.flatnonzero(found)
    points = points_base.reshape(-1, 3)[at]
    is_other = ~within(points, station, _BESIDE_M)
    for box in scene_boxes(station.scene)[1:]:
        half_m = np.array(box.size_m) / 2 + _FIXTURE_M
        off_m = points - np.array(box.center_m, dtype=np.float32)
        is_other |= (np.abs(off_m[:, :2]) < half_m[:2]).all(axis=1) & (off_m[:, 2] < half_m[2])
    found.ravel()[at[is_other]] = False
    return found


def region_corners_m(station: Station) -> npt.NDArray[np.float64]:
    """Two opposite corners (2, 2) of the pick region."""
    x_min, x_max, y_min, y_max = station.scene.pick_region_m
    return np.array([[x_min, y_min], [x_max, y_max]])
