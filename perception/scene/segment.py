"""The *depth* segmenter: objects above the table in the pick region, their outlines refined by colour. In ``base``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import CameraModel
from config.schema import Station
from perception.geometry.crop import Crop
from perception.geometry.depth import Rgbd

_TABLE_BAND_M = 0.015
_INLIER_M = 0.004
_MIN_AREA_PX = 150
_BRIDGE_PX = 9
"""Parts closer than this are one object, because thin parts break up in depth."""
_TABLE_STEP = 5
_SEEN_STEP_M = 0.01
_MIN_TABLE_POINTS = 100
_DISK = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))
_AROUND_PX = 12
_EMBRACED = 0.3
"""Gaps up to this share of the object's extent are examined."""
_FOREIGN = 25.0
"""Squared standard deviations from the table's colour above which a pixel is not the table."""
_SEEN_THROUGH = 0.4
_CONFUSED = 0.05
"""Colour is ignored when more than this share of the surroundings has the object's colour."""

Mask = npt.NDArray[np.bool_]
Array = npt.NDArray[np.float64]
Points = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Scene:
    """The points of all pixels with depth, and the mask of one object.

    Attributes:
        points_base: (H, W, 3) in ``base``, NaN = no depth.
        height_m: (H, W) above the fitted table.
        object_mask: (H, W).
    """

    points_base: Points
    height_m: npt.NDArray[np.float32]
    object_mask: Mask

    def within(self, crop: Crop) -> Scene:
        """The part of the scene inside a crop."""
        return Scene(crop.of(self.points_base), crop.of(self.height_m), crop.of(self.object_mask))


def segment(rgbd: Rgbd, base_from_color: Transform, station: Station) -> tuple[Scene, ...]:
    """Remove the table and cluster the points above it in the pick region: one scene per object, the largest first.

    Args:
        base_from_color: (4, 4) pose of the colour camera.

    Raises: CycleFailure: NO_OBJECT when the table was seen and is empty; NOT_SEEN when too little of it was seen.
    """
    points_base = image_points(rgbd, base_from_color)
    height_m = height_above_table(points_base)
    x_min, x_max, y_min, y_max = station.scene.pick_region_m
    x, y = points_base[..., 0], points_base[..., 1]
    inside = (x > x_min) & (x < x_max) & (y > y_min) & (y < y_max)
    raised = inside & (height_m > station.perception.min_object_height_m)
    clusters = _clusters(raised)
    if not clusters:
        _require_seen(rgbd, base_from_color, height_m, station)
        raise CycleFailure(Code.NO_OBJECT, "Nothing rises above the table inside the pick region.")
    seen = np.isfinite(height_m)
    return tuple(Scene(points_base, height_m, _outlined(cluster, seen, rgbd.color)) for cluster in clusters)


def _require_seen(rgbd: Rgbd, base_from_color: Transform, height_m: npt.NDArray[np.float32], station: Station) -> None:
    """Require that enough of the pick region was seen to call it empty. Raises: CycleFailure(NOT_SEEN)."""
    seen, needed = _seen_share(rgbd.camera, base_from_color, height_m, station), station.perception.min_table_seen
    if seen < needed:
        text = (
            f"Nothing rises above the table, but only {seen:.0%} of the pick region was seen; {needed:.0%} are needed."
        )
        raise CycleFailure(Code.NOT_SEEN, text)


def _seen_share(
    camera: CameraModel, base_from_color: Transform, height_m: npt.NDArray[np.float32], station: Station
) -> float:
    """Share of the pick region, at the table's height, that is in the image and has depth."""
    x_min, x_max, y_min, y_max = station.scene.pick_region_m
    x_m, y_m = np.meshgrid(np.arange(x_min, x_max, _SEEN_STEP_M), np.arange(y_min, y_max, _SEEN_STEP_M))
    grid_m = np.stack([x_m, y_m, np.zeros_like(x_m)], axis=-1).reshape(-1, 3)
    x, y, z = ((grid_m - base_from_color[:3, 3]) @ base_from_color[:3, :3]).T
    in_front = z > 0
    scale = 1.0 / np.where(in_front, z, 1.0)
    u = np.rint(camera.fx * x * scale + camera.cx).astype(int)
    v = np.rint(camera.fy * y * scale + camera.cy).astype(int)
    in_view = in_front & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    return float(np.isfinite(height_m[v[in_view], u[in_view]]).sum() / len(grid_m))


def image_points(rgbd: Rgbd, base_from_color: Transform) -> Points:
    """Points (H, W, 3) [m] in ``base``, NaN where there is no depth."""
    turned = _rays(rgbd.camera) @ base_from_color[:3, :3].T.astype(np.float32)
    points = turned.reshape(*rgbd.depth_m.shape, 3) * rgbd.depth_m[..., None]
    points += base_from_color[:3, 3].astype(np.float32)
    return points


@lru_cache(maxsize=4)
def _rays(camera: CameraModel) -> Points:
    """Rays (H x W, 3) with z = 1 of an undistorted camera."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    return rays.reshape(-1, 3).astype(np.float32)


def height_above_table(points_base: Points) -> npt.NDArray[np.float32]:
    """Height (H, W) [m] above the plane fitted to the points (H, W, 3) near z = 0 of ``base``, trimmed twice.

    Raises: CycleFailure(NOT_SEEN) when no table is seen.
    """
    coarse = points_base[::_TABLE_STEP, ::_TABLE_STEP].reshape(-1, 3).astype(float)
    near = coarse[np.abs(coarse[:, 2]) < _TABLE_BAND_M]
    if len(near) < _MIN_TABLE_POINTS:
        raise CycleFailure(Code.NOT_SEEN, "The camera sees no table at the height it is configured for.")
    coefficients: Array = np.zeros(3)
    for _ in range(3):
        close = np.abs(near[:, 2] - _plane(coefficients, near)) < _INLIER_M if coefficients.any() else slice(None)
        table = near[close]
        design = np.column_stack([table[:, :2], np.ones(len(table))])
        coefficients = np.asarray(np.linalg.lstsq(design, table[:, 2], rcond=None)[0])
    return np.asarray(points_base[..., 2] - _plane(coefficients.astype(np.float32), points_base))


def _plane(coefficients: npt.NDArray[np.floating], points: npt.NDArray[np.floating]) -> npt.NDArray[Any]:
    return np.asarray(points[..., 0] * coefficients[0] + points[..., 1] * coefficients[1] + coefficients[2])


def _clusters(raised: Mask) -> list[Mask]:
    """Groups of raised pixels above the minimum area, the largest first."""
    clean = cv2.morphologyEx(raised.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3)))
    bridged = cv2.dilate(clean, np.ones((_BRIDGE_PX, _BRIDGE_PX)))
    _, labels = cv2.connectedComponents(bridged)
    areas = np.bincount(labels[clean > 0], minlength=1)
    big = [label for label in np.argsort(-areas, kind="stable") if areas[label] >= _MIN_AREA_PX]
    return [np.asarray((labels == label) & (clean > 0)) for label in big]


def _outlined(cluster: Mask, seen: Mask, color: npt.NDArray[np.uint8]) -> Mask:
    """A cluster with its holes closed and its rim refined by colour."""
    crop = Crop.around(cluster, _AROUND_PX)
    part, seen_part = crop.of(color), crop.of(seen)
    whole = _filled(_bridged(crop.of(cluster), seen_part, part), seen_part)
    return crop.back(refined_by_color(part, whole), np.zeros_like(cluster))


def _bridged(mask: Mask, seen: Mask, color: npt.NDArray[np.uint8]) -> Mask:
    """The mask plus the gaps between its parts that are not the table: without depth, or of another colour."""
    reach = int(_EMBRACED * max(mask.shape)) | 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))
    framed = np.pad(mask.astype(np.uint8), reach)
    embraced = cv2.morphologyEx(framed, cv2.MORPH_CLOSE, kernel)[reach:-reach, reach:-reach] > 0
    beside = ~(cv2.dilate(embraced.astype(np.uint8), _DISK) > 0)
    if beside.sum() < _MIN_AREA_PX:
        return mask
    lab = cv2.cvtColor(cv2.blur(color, (3, 3)), cv2.COLOR_RGB2LAB).astype(np.float32)
    foreign = _distance(lab, lab[beside]) - float(np.median(_distance(lab[beside], lab[beside]))) > _FOREIGN
    added = cv2.morphologyEx((embraced & ~mask & (foreign | ~seen)).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3)))
    return np.asarray(mask | (added > 0))


def _filled(mask: Mask, seen: Mask) -> Mask:
    """The mask without holes that only missing depth causes: dark, shiny or steep parts inside the outline."""
    closed = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, _DISK)
    contours, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    whole = cv2.drawContours(np.zeros_like(closed), contours, -1, 1, cv2.FILLED)
    count, holes = cv2.connectedComponents(whole - closed)
    # A hole through which the table is seen stays open.
    see_through = [label for label in range(1, count) if seen[holes == label].mean() > _SEEN_THROUGH]
    return np.asarray((whole > 0) & ~np.isin(holes, see_through))


def refined_by_color(color: npt.NDArray[np.uint8], mask: Mask) -> Mask:
    """The mask (H, W) with its rim redrawn where object and surroundings differ in colour: depth edges are ragged.

    Only a band of 3 pixels on either side of the outline may change.
    """
    part = mask.astype(np.uint8)
    lab = cv2.cvtColor(cv2.blur(color, (3, 3)), cv2.COLOR_RGB2LAB).astype(np.float32)
    core, whole = cv2.erode(part, _DISK) > 0, cv2.dilate(part, _DISK) > 0
    beside = (cv2.dilate(part, _DISK, iterations=3) > 0) & ~whole
    if core.sum() < _MIN_AREA_PX or beside.sum() < _MIN_AREA_PX:
        return mask
    band = whole & ~core
    nearer = _distance(lab[band], lab[core]) < _distance(lab[band], lab[beside])
    if (_distance(lab[beside], lab[core]) < _distance(lab[beside], lab[beside])).mean() > _CONFUSED:
        return mask
    redrawn = core.copy()
    redrawn[band] = nearer
    return np.asarray(cv2.morphologyEx(redrawn.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3))) > 0)


def _distance(lab: Array, samples: Array) -> Array:
    """Gaussian cost (n,) of colours (n, 3) under the samples' mean and covariance."""
    mean, covariance = samples.mean(axis=0), np.cov(samples.T) + 4.0 * np.eye(3)
    off = lab - mean
    return np.asarray((off @ np.linalg.inv(covariance) * off).sum(axis=-1) + np.log(np.linalg.det(covariance)))


def hue_of(rgb: tuple[int, int, int]) -> int:
    """OpenCV's hue, 0 to 179, of a colour (r, g, b)."""
    return int(cv2.cvtColor(np.array([[rgb]], dtype=np.uint8), cv2.COLOR_RGB2HSV)[0, 0, 0])
