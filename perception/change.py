"""What changed on the table: is the place where the object lay empty now?"""

from __future__ import annotations

import numpy as np

from bus.messages import Detections, Observation
from config.schema import Station
from perception.depth import register
from perception.segment import height_above_table, image_points

_CELL_M = 0.004


def cleared_fraction(detections: Detections, before: Observation, after: Observation, station: Station) -> float:
    """Share of the 4 mm cells under the object that the second capture shows at table height.

    A cell the second capture does not see does not count as cleared.
    """
    was = image_points(register(before.frame), before.view.base_from_color)[detections.evidence.object_mask]
    lay = _cells(was[np.isfinite(was[:, 2])])
    now = image_points(register(after.frame), after.view.base_from_color)
    height_m = height_above_table(now)
    table = np.isfinite(height_m) & (np.abs(height_m) < station.perception.min_object_height_m)
    standing = np.isfinite(height_m) & (height_m >= station.perception.min_object_height_m)
    # Noise scatters single points: a cell counts as empty when most of what is seen in it is table.
    empty, empty_count = np.unique(_cells(now[table], unique=False), axis=0, return_counts=True)
    full, full_count = np.unique(_cells(now[standing], unique=False), axis=0, return_counts=True)
    counts = dict(zip(map(tuple, full), full_count, strict=True))
    cleared = {tuple(cell) for cell, n in zip(empty, empty_count, strict=True) if n > counts.get(tuple(cell), 0)}
    return sum(tuple(cell) in cleared for cell in lay) / len(lay) if len(lay) else 0.0


def _cells(points: np.ndarray, *, unique: bool = True) -> np.ndarray:
    cells = np.floor(points[:, :2] / _CELL_M).astype(int)
    return np.unique(cells, axis=0) if unique else cells
