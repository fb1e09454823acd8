"""Observed obstacles besides the target, as a height field: each cell is solid up to the highest point in it.

A camera that looks down sees tops, not sides, and nothing behind an edge. So every column is filled from below, and
the line between neighbouring pixels that lie apart in depth counts as observed: the space that an edge hides is taken
for solid. Frames: docs/frames.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import coal
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from bus.arrays import Joints, Points
from bus.transforms import from_translation
from config.scene import Box
from planning.robot import convex_hull
from planning.world import Thing

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

CELL_M = 0.005
KNOWN_M = 0.012
"""Points so near to a box of the station file belong to that box (depth noise, edges)."""
OBSERVED = "an observed obstacle"
_BELOW_M = 0.05
_MAX_SHEET_M = 1.0
_ENOUGH_POINTS = 300
_BESIDE_M = 0.002 * np.array([[-1, -1, 0], [-1, 1, 0], [1, -1, 0], [1, 1, 0]])
_ABOVE_M = 0.002
"""A point so little above the merged heights still stands for them."""
_BESIDE_TARGET_PX = 2
"""Depth at the target's outline mixes with the background's."""


@dataclass(frozen=True)
class Sight:
    """The view of the scene from one look.

    Attributes:
        points_base: (H, W, 3) [m] in ``base``, NaN = no depth; neighbours on one surface are nearer than a cell.
        target: (H, W) the object to be grasped.
        q_rad: (joints,) where the arm stood, which may be in sight itself; None = it is not.
    """

    points_base: Points
    target: npt.NDArray[np.bool_]
    q_rad: Joints | None = None


@dataclass(frozen=True, eq=False)
class ObservedHeightField:
    """Heights over a grid of ``base`` x and y.

    Attributes:
        origin_m: (x, y) of node [0, 0]. ``height_m``: (ny, nx) [m] in ``base``; below the table where nothing is.
        points: (n, 3) the observed points [m] in ``base``, for the independent check of the gate.
        seen: how many of them were measured; the others, at the end, lie in space that an edge hides.
    """

    origin_m: Array
    height_m: Array
    points: Array
    seen: int = 0

    @cached_property
    def thing(self) -> Thing:
        """The field as an obstacle, filled down to the table."""
        ny, nx = self.height_m.shape
        size = np.array([nx - 1, ny - 1]) * CELL_M
        x_m, y_m = self.origin_m + size / 2
        # coal counts rows from the largest y on
        field = coal.HeightFieldAABB(size[0], size[1], self.height_m[::-1], float(self.height_m.min()) - _BELOW_M)
        return Thing(OBSERVED, field, from_translation((x_m, y_m, 0.0)))

    @cached_property
    def points_thing(self) -> Thing:
        """The points alone as an obstacle: each is a cube that reaches at most half its size above the point."""
        return Thing(OBSERVED, coal.makeOctree(self.points - [0.0, 0.0, CELL_M / 2], CELL_M))


def observed_field(sights: Sequence[Sight], boxes: Sequence[Box]) -> ObservedHeightField | None:
    """Return the obstacles in one depth image or several; None when they show only known boxes and the target.

    What one image shows is there. What is only hidden from one of several images is free where another one sees past.

    Args:
        boxes: the known boxes; the first is the table.
    """
    table_m = boxes[0].center_m[2] + boxes[0].size_m[2] / 2 + KNOWN_M
    shown = [_around_target(sight) for sight in sights]
    single = _unknown(np.concatenate([_above(points, table_m) for points in shown]), boxes)
    hidden = [_unknown(_shadows(points, table_m), boxes) for points in shown]
    seen = np.concatenate([single, *hidden])
    if not len(seen):
        return None
    low = np.floor(seen[:, :2].min(axis=0) / CELL_M) - 1
    columns, rows = (np.floor(seen[:, :2].max(axis=0) / CELL_M) - low).astype(int) + 3
    nothing = np.full((rows, columns), boxes[0].center_m[2] - boxes[0].size_m[2] / 2)
    if len(sights) == 1:
        return ObservedHeightField(low * CELL_M, _raised_to(nothing, seen, low), seen, len(single))
    maps = [_raised_to(_floor_of(nothing, points, low), one, low) for points, one in zip(shown, hidden, strict=True)]
    height_m = np.maximum(_raised_to(nothing, single, low), np.fmin.reduce([nothing * np.nan, *maps]))
    height_m = np.where(np.isnan(height_m), nothing, height_m)
    kept = [one[one[:, 2] <= _at(height_m, one, low) + _ABOVE_M] for one in hidden]
    return ObservedHeightField(low * CELL_M, height_m, np.concatenate([single, *kept]), len(single))


def _around_target(sight: Sight) -> Points:
    """The points (H, W, 3) of a sight; infinite on the target and at its outline, NaN = no depth."""
    around = ndimage.binary_dilation(sight.target, iterations=_BESIDE_TARGET_PX)
    return np.where(around[..., None], np.float32(np.inf), sight.points_base)


def _above(points: Points, table_m: float) -> Array:
    """The points (n, 3) above the table that are not the target's."""
    return points[np.isfinite(points[..., 2]) & (points[..., 2] > table_m)].astype(float)


def _shadows(points: Points, table_m: float) -> Array:
    """Points (n, 3) on the lines between neighbours that lie apart, along rows and columns."""
    return np.concatenate([_sheets(points, table_m), _sheets(points.transpose(1, 0, 2), table_m)]).astype(float)


def _raised_to(height_m: Array, points: Array, low: Array) -> Array:
    """Heights (ny, nx) raised to points (n, 3) at the corners of each point's cell; ``low``: the first cell."""
    height_m = height_m.copy()
    column, row = (np.floor(points[:, :2] / CELL_M) - low).astype(int).T
    for dr, dc in ((0, 0), (0, 1), (1, 0), (1, 1)):
        np.fmax.at(height_m, (row + dr, column + dc), points[:, 2])
    return height_m


def _floor_of(nothing: Array, points: Points, low: Array) -> Array:
    """Heights (ny, nx) where one image shows anything at all: nothing there; NaN elsewhere."""
    flat = points[np.isfinite(points[..., 2])]
    column, row = (np.floor(flat[:, :2].astype(float) / CELL_M) - low).astype(int).T
    inside = (column >= 0) & (row >= 0) & (column < nothing.shape[1]) & (row < nothing.shape[0])
    shows = np.zeros(nothing.shape, dtype=bool)
    shows[row[inside], column[inside]] = True
    return np.where(ndimage.binary_dilation(shows), nothing, np.nan)


def _at(height_m: Array, points: Array, low: Array) -> Array:
    """The height (n,) at the cell of each point (n, 3)."""
    column, row = (np.floor(points[:, :2] / CELL_M) - low).astype(int).T
    return np.asarray(height_m[row, column])


def _sheets(points: Points, table_m: float) -> Points:
    """Return points (n, 3) on the lines between row neighbours of an image (H, W, 3) that lie apart.

    Pairs with both points on the table are left out. A neighbour is the next pixel with depth; infinite points are the
    target, which joins nothing.
    """
    nothing = np.isnan(points[..., 2])
    last = np.maximum.accumulate(np.where(nothing, -1, np.arange(points.shape[1])), axis=1)
    before = last[:, :-1]
    raised = points[..., 2] > table_m
    raised |= np.take_along_axis(raised, np.maximum(np.pad(before, ((0, 0), (1, 0))), 0), axis=1)
    rows, columns = np.nonzero(~nothing[:, 1:] & (before >= 0) & raised[:, 1:])
    a, b = points[rows, before[rows, columns]], points[rows, columns + 1]
    with np.errstate(invalid="ignore"):
        along = b - a  # NaN or infinite beside the target
    gap_m = np.linalg.norm(along, axis=1)
    apart = (gap_m > CELL_M) & (gap_m < _MAX_SHEET_M)
    a, along = a[apart], along[apart]
    steps = np.ceil(gap_m[apart] / CELL_M).astype(int)
    number = np.repeat(np.arange(len(steps)), steps)
    share = (np.arange(len(number)) - np.repeat(np.cumsum(steps) - steps, steps)) / steps[number]
    return np.asarray(a[number] + share[:, None].astype(np.float32) * along[number])


def _unknown(points: Array, boxes: Sequence[Box]) -> Array:
    """Return the points outside every known box."""
    known = np.zeros(len(points), dtype=bool)
    for box in boxes:
        known |= (np.abs(points - box.center_m) <= np.array(box.size_m) / 2 + KNOWN_M).all(axis=1)
    return points[~known]


def solid(points_base: Array, floor_m: float) -> coal.CollisionGeometry:
    """Return the convex hull of points (n, 3) in ``base`` and of their projections onto the height ``floor_m``.

    It reaches 2 mm beyond the points on each side: depth pixels miss edges, and a single row of them is no solid.
    """
    raised = (points_base[:, None] + _BESIDE_M).reshape(-1, 3)
    raised[:, 2] = np.maximum(raised[:, 2], floor_m + 1e-3)
    on_floor = raised.copy()
    on_floor[:, 2] = floor_m
    return convex_hull(np.concatenate([raised, on_floor]))


def subsample(points: Array) -> Array:
    """Return about 300 of the points (n, 3), evenly picked."""
    return points[:: max(1, len(points) // _ENOUGH_POINTS)]
