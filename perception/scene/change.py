"""Scene change: did the object leave its place, on the table or on other things? In ``base``; see docs/frames.md."""

from __future__ import annotations

import numpy as np

from bus.arrays import Points
from bus.messages import Detections, Observation
from bus.transforms import apply, inverse
from config.schema import Station
from perception.geometry.depth import moved, without_flying_pixels
from perception.scene.depth_view import DepthView
from perception.scene.surroundings import surroundings
from perception.scene.table import find_table

_CELL_M = 0.004
_HANGING_M = 0.15
"""Points above this height are the object in the hand, not objects on the table."""
_MIN_SEEN = 0.25


def cleared_fraction(
    detections: Detections,
    instance: int,
    before: Observation,
    after: Observation,
    station: Station,
    part_base: Points | None = None,
) -> float | None:
    """Share of the 4 mm cells under an object that the second capture shows at table height, or lower than it was.

    Cells that the second capture does not see (e.g. behind the held object) are left out; None when less than a quarter
    is seen, or the object was not in the look that is shown. In a heap others lie under the object.

    Args:
        instance: the number of the object that was grasped.
        part_base: (n, 3) in ``base`` the points of that part of it which alone should have left; None = all of it.
    """
    was = points_of(detections, instance, before) if part_base is None else np.asarray(part_base, dtype=float)
    if not len(was):
        return None
    was_m = apply(inverse(detections.scene.table.base_from_table), was)[:, 2]
    least_m = station.perception.min_object_height_m
    raised = was_m >= least_m  # an outline holds a rim of table, too
    was, was_m = (was[raised], was_m[raised]) if raised.any() else (was, was_m)
    lay = np.unique(_cells(was), axis=0)
    now = DepthView.of(after, without_flying_pixels(after.frame.depth_m)).points_base
    height_m = moved(now, find_table(now, station).table_from_base)[..., 2]
    low = np.isfinite(height_m) & (height_m < _HANGING_M)
    cells = _cells(now[low])
    standing = _means(lay, cells, height_m[low] >= least_m)
    seen = ~np.isnan(standing)
    if seen.sum() < _MIN_SEEN * len(lay):
        return None
    fell = _means(lay, cells, height_m[low]) < _means(lay, _cells(was), was_m) - least_m
    # Noise scatters single points: a cell is empty when most of its points are at table height.
    return float(np.mean((standing < 0.5)[seen] | fell[seen]))


def points_of(detections: Detections, instance: int, before: Observation) -> np.ndarray:
    """(n, 3) what was seen of an object, in ``base``: the evidence's points, when the evidence is of this object."""
    if instance == detections.grasps[0].instance:
        return apply(before.view.base_from_color, detections.evidence.observed_points.astype(float))
    points, is_target = surroundings(before, detections.scene.labels == instance)
    ours = points[is_target].astype(float)
    return np.asarray(ours[np.isfinite(ours[:, 2])])


def _cells(points: np.ndarray) -> np.ndarray:
    """(n, 2) cell indices of points (n, 3) [m] in ``base``."""
    return np.floor(points[:, :2] / _CELL_M).astype(int)


def _means(of: np.ndarray, cells: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The mean (k,) of the ``values`` (n,) in each of the cells ``of`` (k, 2); ``cells`` (n, 2). NaN = none there."""
    low, shape = of.min(axis=0), np.ptp(of, axis=0) + 1
    near = ((cells >= low) & (cells < low + shape)).all(axis=1)
    flat = np.ravel_multi_index((cells[near] - low).T, shape)
    asked = np.ravel_multi_index((of - low).T, shape)
    counts = np.bincount(flat, minlength=shape.prod())[asked]
    sums = np.bincount(flat, weights=values[near], minlength=shape.prod())[asked]
    return np.asarray(np.where(counts > 0, sums / np.maximum(counts, 1), np.nan))
