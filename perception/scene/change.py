"""Scene change on the table: is the object's place empty after the pick? In ``base``; see docs/frames.md."""

from __future__ import annotations

import numpy as np

from bus.messages import Detections, Observation
from config.schema import Station
from perception.geometry.depth import register
from perception.geometry.lift import transform
from perception.scene.segment import height_above_table, image_points

_CELL_M = 0.004
_HANGING_M = 0.15
"""Points above this height are the object in the hand, not objects on the table."""
_MIN_SEEN = 0.25


def cleared_fraction(detections: Detections, before: Observation, after: Observation, station: Station) -> float:
    """Share of the 4 mm cells under the object that the second capture shows at table height.

    Cells that the second capture does not see (e.g. behind the held object) are left out; when less than a quarter is
    seen, the share is 0.
    """
    was = detections.evidence.observed_points.astype(float)
    lay = np.unique(_cells(transform(before.view.base_from_color, was)), axis=0)
    now = image_points(register(after.frame), after.view.base_from_color)
    height_m = height_above_table(now)
    low = np.isfinite(height_m) & (height_m < _HANGING_M)
    cells = _cells(now[low])
    standing = height_m[low] >= station.perception.min_object_height_m
    share = _mean_by_cell(cells, standing)
    seen = [share[tuple(cell)] for cell in lay if tuple(cell) in share]
    if len(seen) < _MIN_SEEN * len(lay):
        return 0.0
    # Noise scatters single points: a cell is empty when most of its points are at table height.
    return float(np.mean(np.array(seen) < 0.5))


def _cells(points: np.ndarray) -> np.ndarray:
    """(n, 2) cell indices of points (n, 3) [m] in ``base``."""
    return np.floor(points[:, :2] / _CELL_M).astype(int)


def _mean_by_cell(cells: np.ndarray, values: np.ndarray) -> dict[tuple[int, ...], float]:
    keys, index, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    means = np.bincount(index.ravel(), weights=values) / counts
    return dict(zip(map(tuple, keys.tolist()), means.tolist(), strict=True))
