"""Scene change beside the object: which other things left their places, too, and did not only move.

In ``base``; see docs/frames.md.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from bus.messages import Detections, Observation
from bus.transforms import inverse
from config.schema import Station
from perception.geometry.depth import moved, registered, without_flying_pixels
from perception.scene.depth_view import DepthView
from perception.scene.table import find_table

_CELL_M = 0.004
_HANGING_M = 0.15
"""Points above this height are what hangs in the hand."""
_MIN_SEEN, _MIN_NET = 0.5, 0.5
_NEAR_M = 0.15
"""So far around its place a thing that was only pushed, or fell over, is looked for."""
_PATCH = np.ones((3, 3), dtype=bool)
"""12 mm: smaller patches of new height are the ragged edges of what stayed."""

Mask = npt.NDArray[np.bool_]
Grid = npt.NDArray[np.float64]


class Others(NamedTuple):
    """The fate of the things beside the one that was grasped, by their numbers.

    Attributes:
        gone: their place is empty, or lower than it was, and nothing as large stands newly near it.
        apart: those of them that nothing which left joined to what was grasped, and which are so no part of it.
        unseen: the second capture sees less than half of their place, or they are nowhere 12 mm wide: of wires and
            rims the camera loses the depth, from one side more than from another.
    """

    gone: tuple[int, ...] = ()
    apart: tuple[int, ...] = ()
    unseen: tuple[int, ...] = ()


def others_gone(
    detections: Detections, instance: int, before: Observation, after: Observation, station: Station
) -> Others:
    """Compare the place of every thing but ``instance`` in both captures.

    A neighbour that the hand pushed aside empties its place, too, but stands elsewhere then: what newly rises within
    150 mm is subtracted.

    Args:
        instance: the number of the object that was grasped.
        before: the look that is shown in ``detections``. ``after``: the second capture.
    """
    numbers = [one.number for one in detections.scene.instances if one.number != instance]
    if not numbers:
        return Others()
    least_m = station.perception.min_object_height_m
    was_base, was_m, label = _labelled(detections, before)
    now_base, now_m = _low(after, station)
    grid = _Grid.around(was_base[np.isin(label, numbers) & (was_m >= least_m)])
    was, now = _Heights.of(grid, was_base, was_m, least_m), _Heights.of(grid, now_base, now_m, least_m)
    rises = ((now.standing >= 0.5) & (was.standing < 0.5)) | (now.mean_m > was.mean_m + least_m)
    new = ndimage.binary_opening(rises, _PATCH)
    its = label == instance
    left = _joined(was, now, least_m)
    held = np.unique(left[~np.isnan(_Heights.of(grid, was_base[its], was_m[its], least_m).mean_m)])
    emptied: dict[int, _Emptied] = {}
    unseen, apart = [], []
    for number in numbers:
        ours = (label == number) & (was_m >= least_m)
        lay = _Heights.of(grid, was_base[ours], was_m[ours], least_m)
        place = ndimage.binary_opening(~np.isnan(lay.mean_m) & (was.standing >= 0.5), _PATCH)
        seen = place & ~np.isnan(now.mean_m)
        if not place.any() or seen.sum() < _MIN_SEEN * place.sum():
            unseen.append(number)
            continue
        empty = seen & ((now.standing < 0.5) | (now.top_m < lay.mean_m - least_m))
        if empty.sum() >= station.verify.min_cleared_fraction * seen.sum():
            emptied[number] = _Emptied(int(empty.sum()), int((new & grid.near(place, _NEAR_M)).sum()))
            apart += [] if np.isin(left[place], held[held > 0]).any() else [number]
    gone = _not_moved(emptied, int(new.sum()))
    apart = [number for number in apart if number in gone]
    return Others(tuple(gone), tuple(apart), tuple(unseen))


class _Emptied(NamedTuple):
    """Numbers of cells: of a place that is empty now, and of those near it that rose."""

    cells: int
    rose: int


def _not_moved(emptied: dict[int, _Emptied], rose: int) -> list[int]:
    """Return which of the emptied places' things stand nowhere else; what rose (cells, in all) explains each once."""
    gone = []
    for number, one in sorted(emptied.items(), key=lambda item: abs(item[1].cells - item[1].rose)):
        if one.cells - min(one.rose, rose) < _MIN_NET * one.cells:
            rose -= min(rose, one.cells)
        else:
            gone.append(number)
    return sorted(gone)


def _labelled(
    detections: Detections, before: Observation
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.int16]]:
    """Points (n, 3) [m] of the depth image in ``base``, their heights (n,), and the numbers (n,) of their things."""
    depth_m = without_flying_pixels(before.frame.depth_m)
    _, source = registered(before.frame, depth_m)
    label = np.zeros(depth_m.size, dtype=np.int16)
    label[source[source >= 0]] = detections.scene.labels[source >= 0]
    points = DepthView.of(before, depth_m).points_base
    height_m = moved(points, inverse(detections.scene.table.base_from_table))[..., 2].ravel()
    is_seen = np.isfinite(height_m)
    return points.reshape(-1, 3)[is_seen], height_m[is_seen], label[is_seen]


def _low(after: Observation, station: Station) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """The points (n, 3) [m] of the second capture below the hand, in ``base``, and their heights (n,)."""
    points = DepthView.of(after, without_flying_pixels(after.frame.depth_m)).points_base
    height_m = moved(points, find_table(points, station).table_from_base)[..., 2]
    low = np.isfinite(height_m) & (height_m < _HANGING_M)
    return points[low], height_m[low]


def _joined(was: _Heights, now: _Heights, least_m: float) -> npt.NDArray[np.int32]:
    """Number the connected patches of what left its place, or may have, from 1 on; gaps up to 8 mm do not part them."""
    stood, unseen = was.standing >= 0.5, np.isnan(now.mean_m)
    left = stood & (unseen | (now.standing < 0.5) | (now.top_m < was.mean_m - least_m))
    return np.asarray(ndimage.label(ndimage.binary_dilation(left, _PATCH), _PATCH)[0], dtype=np.int32)


class _Grid(NamedTuple):
    """Cells of 4 mm in ``base``: the lowest one's index (2,), and their number along x and y."""

    low: npt.NDArray[np.int64]
    shape: tuple[int, int]

    @classmethod
    def around(cls, points_base: npt.NDArray[np.float32]) -> _Grid:
        cells = np.floor(points_base[:, :2] / _CELL_M).astype(int) if len(points_base) else np.zeros((1, 2), dtype=int)
        margin = round(_NEAR_M / _CELL_M)
        low, high = cells.min(axis=0) - margin, cells.max(axis=0) + margin
        return cls(low, (int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1))

    def near(self, place: Mask, reach_m: float) -> Mask:
        """The cells within ``reach_m`` of any of ``place``; of none where there is none."""
        if not place.any():
            return place
        return np.asarray(ndimage.distance_transform_edt(~place) <= reach_m / _CELL_M)


class _Heights(NamedTuple):
    """Heights [m] of each cell; NaN = none seen.

    Attributes:
        mean_m: of its points. ``standing``: the share of them that stand above the table.
        top_m: the highest of it and of its eight neighbours: from aside, the sides of what stands are seen, too.
    """

    mean_m: Grid
    standing: Grid
    top_m: Grid

    @classmethod
    def of(
        cls,
        grid: _Grid,
        points_base: npt.NDArray[np.float32],
        height_m: npt.NDArray[np.float32],
        least_m: float,
    ) -> _Heights:
        cells = np.floor(points_base[:, :2] / _CELL_M).astype(int) - grid.low
        inside = ((cells >= 0) & (cells < grid.shape)).all(axis=1)
        flat, height_m = np.ravel_multi_index(tuple(cells[inside].T), grid.shape), height_m[inside]
        length = grid.shape[0] * grid.shape[1]
        count = np.bincount(flat, minlength=length).astype(float)
        count[count == 0] = np.nan
        mean_m, standing = (np.bincount(flat, of, length) / count for of in (height_m, height_m >= least_m))
        top_m = np.full(length, -np.inf)
        np.maximum.at(top_m, flat, height_m)
        around_m = ndimage.maximum_filter(top_m.reshape(grid.shape), footprint=_PATCH)
        return cls(mean_m.reshape(grid.shape), standing.reshape(grid.shape), around_m)
