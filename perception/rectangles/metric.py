"""The rectangle metric: when a predicted grasp rectangle counts as right (Jiang et al. 2011)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bus.messages import Rectangle

MIN_IOU = 0.25
MAX_APART_RAD = float(np.deg2rad(30))

Corners = npt.NDArray[np.float64]


def iou(one: Rectangle, other: Rectangle) -> float:
    """Intersection over union of the areas, 0 to 1; 0 for a rectangle without area."""
    if min(one.width_px, one.height_px, other.width_px, other.height_px) <= 0:
        return 0.0
    shared = _area(_clipped(one.corners_px(), other.corners_px()))
    union = one.width_px * one.height_px + other.width_px * other.height_px - shared
    return float(np.clip(shared / union, 0, 1))


def _clipped(polygon: Corners, by: Corners) -> Corners:
    """The part of a polygon (n, 2) inside a convex one of the same orientation (Sutherland and Hodgman 1974).

    OpenCV 5.0's intersectConvexConvex is wrong by the whole area where edges coincide.
    """
    for start, end in zip(by, np.roll(by, -1, axis=0), strict=True):
        normal = np.array([start[1] - end[1], end[0] - start[0]])
        side = (polygon - start) @ normal
        kept = []
        for index, height in enumerate(side):
            before = side[index - 1]
            if (height < 0) != (before < 0):
                kept.append(polygon[index - 1] + (polygon[index] - polygon[index - 1]) * before / (before - height))
            if height >= 0:
                kept.append(polygon[index])
        if len(kept) < 3:
            return np.zeros((0, 2))
        polygon = np.array(kept)
    return polygon


def _area(polygon: Corners) -> float:
    """Area [px^2] of a polygon (n, 2), by the shoelace formula."""
    u, v = polygon[:, 0], polygon[:, 1]
    return abs(float(u @ np.roll(v, -1) - v @ np.roll(u, -1))) / 2 if len(polygon) else 0.0


def angle_apart_rad(one: Rectangle, other: Rectangle) -> float:
    """Angle between the closing axes, 0 to pi/2."""
    apart = abs(one.angle_rad - other.angle_rad) % np.pi
    return float(min(apart, np.pi - apart))


def matches(predicted: Rectangle, truth: Rectangle) -> bool:
    """True for IoU >= 25 % and axes <= 30 degrees apart."""
    return iou(predicted, truth) >= MIN_IOU and angle_apart_rad(predicted, truth) <= MAX_APART_RAD
