"""Orthographic height maps of the scene: what was seen, and what must count as occupied because it was not.

The *level* frame of a map has its z axis against the approach; for an approach from above it is the table's own frame.
See docs/frames.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from bus.arrays import Transform
from perception.geometry.depth import moved
from perception.scene.depth_view import DepthView

CELL_M = 0.002
MARGIN_M = 0.13
"""Margin around the objects: room for the palm (0.2 m long)."""
_CEILING_M, _LEVEL_M = 0.20, 0.006
"""Unseen cells are examined from the ceiling, or the highest point if that is higher, downwards in such levels."""

_ALONG = float(np.cos(np.deg2rad(35)))
_THICK_M = 0.004
_STILL_SEEN_M = 0.012
"""A surface hides its own place from a level so little above it."""
_TABLE_NOISE_M = 0.003
"""Lower points are the table and the noise of its depth."""

Array = npt.NDArray[np.float64]
Heights = npt.NDArray[np.float32]
Labels = npt.NDArray[np.int16]

_MAPS = ("surface_m", "bound_m", "labels", "pieces", "patches")


@dataclass(frozen=True)
class HeightMap:
    """Heights over a grid of x and y of the level frame.

    Attributes:
        surface_m: (ny, nx) the highest seen point; unseen cells continue their nearest neighbour, below the bound.
        bound_m: (ny, nx) the height up to which the cell may be occupied: the surface, or where nothing was seen the
            lowest height above which the camera saw past it.
        labels: (ny, nx) the thing in the cell, 0 = none. ``pieces``: the piece of it that steps and valleys part from
            others. ``patches``: its even patch of colour.
        origin_m: (x, y) of the centre of cell [0, 0].
        up_xy: (2,) the part of the upward unit vector that lies in the map's plane; 0 in a map from above.
    """

    surface_m: Heights
    bound_m: Heights
    labels: Labels
    pieces: Labels
    patches: Labels
    origin_m: Array
    up_xy: Array = field(default_factory=lambda: np.zeros(2))

    def cells(self, x: npt.NDArray[np.floating], y: npt.NDArray[np.floating]) -> npt.NDArray[np.int32]:
        """Indices into `Framed` maps of points ``x``, ``y`` [m] of any shape; points outside take the frame's."""
        ny, nx = self.surface_m.shape
        column = ((x - np.float32(self.origin_m[0])) * np.float32(1 / CELL_M) + np.float32(1.5)).astype(np.int32)
        row = ((y - np.float32(self.origin_m[1])) * np.float32(1 / CELL_M) + np.float32(1.5)).astype(np.int32)
        np.clip(column, 0, nx + 1, out=column)
        np.clip(row, 0, ny + 1, out=row)
        row *= nx + 2
        row += column
        return row

    @cached_property
    def framed(self) -> Framed:
        """The maps with a rim of one cell: the table, and unseen up to the ceiling."""
        return Framed(
            np.pad(self.surface_m, 1).ravel(),
            np.pad(self.bound_m, 1, constant_values=_CEILING_M).ravel(),
            np.pad(cv2.dilate(self.bound_m, np.ones((3, 3), np.uint8)), 1, constant_values=_CEILING_M).ravel(),
            np.pad(cv2.dilate(self.bound_m, np.ones((5, 5), np.uint8)), 1, constant_values=_CEILING_M).ravel(),
            np.pad(self.labels, 1).ravel(),
            np.pad(self.pieces, 1).ravel(),
            np.pad(self.patches, 1).ravel(),
        )

    @cached_property
    def middles(self) -> tuple[Array, Array]:
        """The middle (k, 2) and the rms radius (k,) [m] of the cells of every number; of number 0, none of ours."""
        cells = np.flatnonzero(self.labels)
        rows, columns = np.divmod(cells, self.labels.shape[1])
        number, xy_m = self.labels.ravel()[cells], self.xy_m(rows, columns)
        count = int(number.max(initial=0)) + 1
        area = np.maximum(np.bincount(number, minlength=count), 1)
        middle = np.stack([np.bincount(number, xy_m[:, axis], count) for axis in (0, 1)], axis=1) / area[:, None]
        off2 = ((xy_m - middle[number]) ** 2).sum(axis=1)
        return middle, np.sqrt(np.bincount(number, off2, count) / area)

    def part(self, window: tuple[slice, slice]) -> HeightMap:
        """Return the part of the map inside a window of rows and columns, which begins inside the map."""
        rows, columns = window
        origin_m = self.origin_m + np.array([columns.start, rows.start]) * CELL_M
        maps = {name: np.ascontiguousarray(getattr(self, name)[window]) for name in _MAPS}
        return replace(self, **maps, origin_m=origin_m)

    def xy_m(self, rows: npt.NDArray[np.int64], columns: npt.NDArray[np.int64]) -> Array:
        """Positions (n, 2) of cells."""
        return np.stack([columns * CELL_M + self.origin_m[0], rows * CELL_M + self.origin_m[1]], axis=1)


@dataclass(frozen=True)
class Framed:
    """The flattened maps of a `HeightMap`, with a rim; indexed by `HeightMap.cells`.

    Attributes:
        beside_m, around_m: the highest bound within 2 and 4 mm: fingers pass other things at a distance, and what lies
            below a palm is looked for in steps of 10 mm.
    """

    surface_m: Heights
    bound_m: Heights
    beside_m: Heights
    around_m: Heights
    labels: Labels
    pieces: Labels
    patches: Labels


@dataclass(frozen=True)
class Grid:
    """The cells that a map covers: ``shape`` (ny, nx) from ``origin_m`` (x, y) on."""

    origin_m: Array
    shape: tuple[int, int]

    @classmethod
    def around(cls, xy_m: npt.NDArray[np.floating], margin_m: float = MARGIN_M) -> Grid:
        """Return the grid that covers points (n, 2) and a margin around them."""
        low, high = xy_m.min(axis=0).astype(float) - margin_m, xy_m.max(axis=0).astype(float) + margin_m
        nx, ny = np.ceil((high - low) / CELL_M).astype(int) + 1
        return cls(low, (int(ny), int(nx)))

    def index(self, xy_m: npt.NDArray[np.floating]) -> npt.NDArray[np.int32]:
        """Flat cell indices (n,) of points (n, 2); -1 outside, and for NaN."""
        ny, nx = self.shape
        column = np.rint((xy_m[:, 0] - np.float32(self.origin_m[0])) * np.float32(1 / CELL_M))
        row = np.rint((xy_m[:, 1] - np.float32(self.origin_m[1])) * np.float32(1 / CELL_M))
        inside = (column >= 0) & (column < nx) & (row >= 0) & (row < ny)
        return np.where(inside, row * np.float32(nx) + column, np.float32(-1)).astype(np.int32)

    def centers_m(self, cells: npt.NDArray[np.integer]) -> Array:
        """Centres (n, 2) of flat cell indices (n,)."""
        rows, columns = np.divmod(cells, self.shape[1])
        return np.stack([columns * CELL_M, rows * CELL_M], axis=1) + self.origin_m


@dataclass(frozen=True)
class Seen:
    """The highest seen point of every cell.

    Attributes:
        height_m: (ny, nx), -inf where nothing was seen. ``point``: (ny, nx) its index, -1 where there is none.
        distance_cells, nearest: (ny, nx) how far the nearest seen cell is, and its flat index.
    """

    height_m: Heights
    point: npt.NDArray[np.int32]
    distance_cells: Heights
    nearest: npt.NDArray[np.int64]

    @property
    def continued_m(self) -> Heights:
        """(ny, nx) heights, unseen cells filled from the nearest seen one; 0 when nothing was seen."""
        if (self.point < 0).all():
            return np.zeros(self.height_m.shape, dtype=np.float32)
        return np.asarray(self.height_m.ravel()[self.nearest])

    def point_within(self, cells: float) -> npt.NDArray[np.int32]:
        """(ny, nx) the point of each cell, or of the nearest seen one at most so far away; -1 for none."""
        return np.where(self.distance_cells <= cells, self.point.ravel()[self.nearest], -1)


def highest(grid: Grid, points: npt.NDArray[np.float32], weights: npt.NDArray[np.floating] | None = None) -> Seen:
    """Return the highest of the points (n, 3), NaN = none, in each cell of the grid; of equals the last.

    Args:
        weights: (n,) of points from several looks. A cell's height is then the mean of those just below its highest:
            the highest of many is the one with the largest error.
    """
    cell = grid.index(points[:, :2])
    inside = np.flatnonzero(cell >= 0)
    # height in steps of 10 um and index in one number, because the maximum must say which point it was
    key = (np.rint(points[inside, 2] * np.float32(1e5)).astype(np.int64) << 32) | inside
    top = np.full(grid.shape[0] * grid.shape[1], np.iinfo(np.int64).min)
    np.maximum.at(top, cell[inside], key)
    point = np.where(top == np.iinfo(np.int64).min, -1, top & 0xFFFFFFFF).astype(np.int32).reshape(grid.shape)
    distance, nearest = ndimage.distance_transform_edt(point < 0, return_indices=True)
    height_m = np.full(grid.shape, -np.inf, dtype=np.float32)
    height_m[point >= 0] = points[point[point >= 0], 2]
    if weights is not None:
        height_m = _mean_below(height_m, cell[inside], points[inside, 2], weights[inside])
    return Seen(height_m, point, distance.astype(np.float32), nearest[0] * grid.shape[1] + nearest[1])


def _mean_below(
    top_m: Heights, cell: npt.NDArray[np.int32], z_m: Heights, weights: npt.NDArray[np.floating]
) -> Heights:
    """The mean height (ny, nx) of the points (n,) at most `_THICK_M` below the highest of their cell."""
    near = z_m > top_m.flat[cell] - np.float32(_THICK_M)
    total = np.bincount(cell[near], weights[near], minlength=top_m.size)
    mean_m = np.bincount(cell[near], weights[near] * z_m[near], minlength=top_m.size) / np.maximum(total, 1e-9)
    return np.where(np.isinf(top_m), top_m, mean_m.reshape(top_m.shape)).astype(np.float32)


def bound(grid: Grid, height_m: Heights, views: Sequence[DepthView], base_from_level: Transform) -> Heights:
    """Up to which height each cell may be occupied: see `HeightMap.bound_m`.

    A cell whose foot is outside every image may be occupied up to the ceiling. Above any other cell a camera looks down
    until something hides what is below from all of them; the upper end of a column near the border, which is not in
    view, counts as free. With one view nothing is above what it sees; a second one sees a wall from aside, without what
    is above it.

    Args:
        height_m: (ny, nx) the highest seen point, -inf = unseen.
    """
    if len(views) == 1:
        free_m = _free_above(grid, np.flatnonzero(np.isinf(height_m)), height_m, views[0], base_from_level)
    else:
        asked = np.flatnonzero(~_seen_along(grid, height_m, views, base_from_level))
        free_m = np.full(height_m.shape, -np.inf, dtype=np.float32)
        free_m.flat[asked] = np.inf
        for view in views:
            free_m = np.minimum(free_m, _free_above(grid, asked, height_m, view, base_from_level))
            asked = asked[np.isfinite(free_m.flat[asked])]  # the others are free down to what was seen
        free_m = np.where(free_m < height_m + _STILL_SEEN_M, height_m, free_m)
    bound_m = np.maximum(height_m, free_m)
    bound_m[bound_m < _TABLE_NOISE_M] = 0.0
    return np.asarray(bound_m)


def _seen_along(
    grid: Grid, height_m: Heights, views: Sequence[DepthView], base_from_level: Transform
) -> npt.NDArray[np.bool_]:
    """The cells (ny * nx,) whose highest seen point a view sees almost along the z axis: nothing is above it."""
    seen = np.flatnonzero(np.isfinite(height_m))
    tops = np.column_stack([grid.centers_m(seen), height_m.flat[seen] + _LEVEL_M]).astype(np.float32)
    tops_base = moved(tops[None], base_from_level)[0]
    along = np.zeros(height_m.size, dtype=bool)
    for view in views:
        ray = tops_base - view.base_from_depth[:3, 3].astype(np.float32)
        cosine = -(ray @ base_from_level[:3, 2].astype(np.float32)) / np.linalg.norm(ray, axis=1)
        along[seen] |= (cosine > _ALONG) & view.in_view(tops_base) & ~view.is_hidden(tops_base)
    return along


def _free_above(
    grid: Grid, cells: npt.NDArray[np.intp], height_m: Heights, view: DepthView, base_from_level: Transform
) -> Heights:
    """The height (ny, nx) above which one view sees the columns of ``cells`` (flat indices) free; -inf elsewhere."""
    free_m = np.full(height_m.shape, -np.inf, dtype=np.float32)
    level_m = max(_CEILING_M, float(height_m.max(initial=0.0)))

    free = free_m.ravel()  # of the same memory
    xyz = np.zeros((len(cells), 3), dtype=np.float32)
    xyz[:, :2] = grid.centers_m(cells)
    in_view = view.in_view(moved(xyz[None], base_from_level)[0])
    free[cells[~in_view]] = level_m
    active, xyz = cells[in_view], xyz[in_view]
    down_to_m = height_m.ravel()[active]
    while len(active) and level_m > 0:
        xyz[:, 2] = level_m
        hidden = view.is_hidden(moved(xyz[None], base_from_level)[0])
        free[active[hidden]] = level_m
        level_m -= _LEVEL_M
        going_on = np.flatnonzero(~hidden & (down_to_m < level_m))
        if len(going_on) < len(active):
            active, xyz, down_to_m = active.take(going_on), xyz.take(going_on, axis=0), down_to_m.take(going_on)
    return free_m
