"""When a predicted grasp rectangle counts as right (Jiang et al. 2011)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bus.messages import Rectangle

MIN_IOU = 0.25
MAX_APART_RAD = float(np.deg2rad(30))

Corners = npt.NDArray[np.float64]


def iou(one: Rectangle, other: Rectangle) -> float:
    """Intersection over union of the areas, 0 to 1; a rectangle without area overlaps nothing."""
    if min(one.width_px, one.height_px, other.width_px, other.height_px) <= 0:
        return 0.0
    shared = _area(_clipped(one.corners_px(), other.corners_px()))
    union = one.width_px * one.height_px + other.width_px * other.height_px - shared
    return float(np.clip(shared / union, 0, 1))


def _clipped(polygon: Corners, by: Corners) -> Corners:
    """What of a polygon lies inside a convex one, turning the same way (Sutherland and Hodgman 1974).

    OpenCV's own answers are wrong by the whole area where edges coincide (intersectConvexConvex, 5.0).
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
    """Gauss's shoelace."""
    u, v = polygon[:, 0], polygon[:, 1]
    return abs(float(u @ np.roll(v, -1) - v @ np.roll(u, -1))) / 2 if len(polygon) else 0.0


def angle_apart_rad(one: Rectangle, other: Rectangle) -> float:
    """Between the closing axes, 0 to pi/2."""
    apart = abs(one.angle_rad - other.angle_rad) % np.pi
    return float(min(apart, np.pi - apart))


def matches(predicted: Rectangle, truth: Rectangle) -> bool:
    """IoU >= 25 % and axes <= 30 degrees apart."""
    return iou(predicted, truth) >= MIN_IOU and angle_apart_rad(predicted, truth) <= MAX_APART_RAD
