"""The *depth* segmenter: what stands on the table inside the pick region; and rod and object in a goal image."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from bus.codes import Code
from bus.errors import CycleFailure
from config.schema import Station
from perception.depth import Rgbd
from perception.lift import lift_pixels, transform

_TABLE_BAND_M = 0.015
_INLIER_M = 0.004
_MIN_AREA_PX = 150
_BRIDGE_PX = 9
"""Parts closer than this are one object: thin arms break up in depth."""
_MIN_TABLE_PX = 2000
_RIM_PX = 81

Mask = npt.NDArray[np.bool_]
Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Scene:
    """Every pixel with depth as a point, and the object among them.

    Attributes:
        points_base: (H, W, 3) in ``base``, NaN = no depth.
        height_m: (H, W) above the fitted table.
        object_mask: (H, W). ``region_mask``: (H, W) the pick region, with a rim for a rod that sticks out.
    """

    points_base: npt.NDArray[np.float64]
    height_m: npt.NDArray[np.float64]
    object_mask: Mask
    region_mask: Mask


def segment(rgbd: Rgbd, base_from_color: Transform, station: Station) -> Scene:
    """Remove the table, cluster what rises above it in the pick region, keep the largest cluster.

    Raises: CycleFailure(NO_OBJECT).
    """
    points_base = image_points(rgbd, base_from_color)
    height_m = height_above_table(points_base)
    x_min, x_max, y_min, y_max = station.scene.pick_region_m
    x, y = points_base[..., 0], points_base[..., 1]
    inside = (x > x_min) & (x < x_max) & (y > y_min) & (y < y_max)
    raised = inside & (height_m > station.perception.min_object_height_m)
    region = cv2.dilate(inside.astype(np.uint8), np.ones((_RIM_PX, _RIM_PX))) > 0
    return Scene(points_base, height_m, _largest_cluster(raised), region)


def image_points(rgbd: Rgbd, base_from_color: Transform) -> Array:
    """(H, W, 3) points in ``base``, NaN where there is no depth."""
    v, u = np.nonzero(np.isfinite(rgbd.depth_m))
    points = np.full((*rgbd.depth_m.shape, 3), np.nan)
    pixels = np.stack([u, v], axis=1).astype(float)
    points[v, u] = transform(base_from_color, lift_pixels(pixels, rgbd.depth_m[v, u].astype(float), rgbd.camera))
    return points


def height_above_table(points_base: Array) -> Array:
    """Height [m] over the plane fitted to what lies near z = 0 of ``base``, trimmed twice.

    Raises: CycleFailure(NO_OBJECT) when no table is seen.
    """
    near = points_base[np.abs(points_base[..., 2]) < _TABLE_BAND_M]
    if len(near) < _MIN_TABLE_PX:
        raise CycleFailure(Code.NO_OBJECT, "The camera sees no table at the height it is configured for.")
    near = near[:: max(1, len(near) // 20_000)]
    coefficients: Array = np.zeros(3)
    for _ in range(3):
        close = np.abs(near[:, 2] - _plane(coefficients, near)) < _INLIER_M if coefficients.any() else slice(None)
        table = near[close]
        design = np.column_stack([table[:, :2], np.ones(len(table))])
        coefficients = np.asarray(np.linalg.lstsq(design, table[:, 2], rcond=None)[0])
    return np.asarray(points_base[..., 2] - _plane(coefficients, points_base))


def _plane(coefficients: Array, points: Array) -> Array:
    return np.asarray(points[..., 0] * coefficients[0] + points[..., 1] * coefficients[1] + coefficients[2])


def _largest_cluster(raised: Mask) -> Mask:
    clean = cv2.morphologyEx(raised.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3)))
    bridged = cv2.dilate(clean, np.ones((_BRIDGE_PX, _BRIDGE_PX)))
    _, labels = cv2.connectedComponents(bridged)
    areas = np.bincount(labels[clean > 0], minlength=1)
    best = int(areas.argmax()) if len(areas) else 0
    if len(areas) == 0 or areas[best] < _MIN_AREA_PX:
        raise CycleFailure(Code.NO_OBJECT, "Nothing rises above the table inside the pick region.")
    return np.asarray((labels == best) & (clean > 0))


def segment_goal(goal: npt.NDArray[np.uint8], rod_rgb: tuple[int, int, int], scene: Scene) -> tuple[Mask, Mask]:
    """Rod and object in a goal image: the rod by the hue it was asked for, the object as what is left of it.

    Returns:
        (rod mask, object mask).
    """
    hsv = cv2.cvtColor(np.asarray(goal), cv2.COLOR_RGB2HSV).astype(int)
    apart = np.abs(hsv[..., 0] - hue_of(rod_rgb))
    rod = (np.minimum(apart, 180 - apart) < 8) & (hsv[..., 1] > 110) & (hsv[..., 2] > 60) & scene.region_mask
    rod = cv2.morphologyEx(rod.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3))) > 0
    return rod, scene.object_mask & ~rod


def hue_of(rgb: tuple[int, int, int]) -> int:
    """OpenCV's hue of a colour, 0 to 179."""
    return int(cv2.cvtColor(np.array([[rgb]], dtype=np.uint8), cv2.COLOR_RGB2HSV)[0, 0, 0])
