"""The things that lie on another: seen from above one parts the other, or cuts into it, and is higher."""

from __future__ import annotations

import cv2
import numpy as np

from perception.scene.scene import Scene

_ON_IT = 0.25
"""A thing lies on another when this share of it is inside the other's convex outline."""
_HIGHER_M = 0.006
"""And when it is so much higher than the other's surface around."""


def lying_on(scene: Scene, number: int) -> list[int]:
    """Return the numbers of the things on thing ``number``, the one with the largest share on it first."""
    labels, surface_m = scene.heights.labels, scene.heights.surface_m
    rows, columns = np.nonzero(labels == number)
    if len(rows) < 3:
        return []
    hull = np.zeros(labels.shape, dtype=np.uint8)
    cv2.fillConvexPoly(hull, cv2.convexHull(np.stack([columns, rows], axis=1).astype(np.int32)), 1)
    inside, ours_m = hull > 0, float(np.median(surface_m[rows, columns]))
    found: list[tuple[float, int]] = []
    for other in sorted(set(np.unique(labels[inside]).tolist()) - {0, number}):
        cells = labels == other
        share = float((cells & inside).sum() / cells.sum())
        if share >= _ON_IT and float(np.median(surface_m[cells & inside])) > ours_m + _HIGHER_M:
            found.append((-share, int(other)))
    return [other for _, other in sorted(found)]
