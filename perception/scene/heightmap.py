"""An orthographic height map of the table around the object, in ``base``; it is independent of the camera's tilt."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from bus.arrays import Transform
from bus.transforms import apply
from perception.scene.segment import Scene

CELL_M = 0.002
MARGIN_M = 0.13
"""Margin around the object: room for the palm (0.2 m long)."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class HeightMap:
    """Heights above the table on a grid over x and y of ``base``.

    Attributes:
        height_m: (ny, nx), every cell filled (unseen ones from their nearest neighbour).
        is_object: (ny, nx) mask of the object.
        origin_m: (x, y) of the centre of cell [0, 0].
    """

    height_m: Array
    is_object: npt.NDArray[np.bool_]
    origin_m: Array

    def at(self, x: Array, y: Array) -> Array:
        """Heights [m] at points ``x``, ``y`` [m] of any shape; 0 (the table) outside the map."""
        ny, nx = self.height_m.shape
        # The map has a rim of table, one cell wide, and points outside are clipped to it.
        column = ((x - self.origin_m[0]) * (1 / CELL_M) + 1.5).astype(np.int32)
        row = ((y - self.origin_m[1]) * (1 / CELL_M) + 1.5).astype(np.int32)
        np.clip(column, 0, nx + 1, out=column)
        np.clip(row, 0, ny + 1, out=row)
        row *= nx + 2
        row += column
        return np.asarray(self._framed.take(row))

    @cached_property
    def _framed(self) -> Array:
        return np.pad(self.height_m, 1).ravel()

    def xy_m(self, rows: npt.NDArray[np.int64], columns: npt.NDArray[np.int64]) -> Array:
        """Positions (n, 2) of cells."""
        return np.stack([columns * CELL_M + self.origin_m[0], rows * CELL_M + self.origin_m[1]], axis=1)


def height_map(scene: Scene, level_from_base: Transform | None = None) -> HeightMap:
    """The map of the highest point seen in every cell.

    Args:
        level_from_base: (4, 4); project along this frame's -z instead of the table's; heights are then its z.
    """
    used = np.isfinite(scene.height_m)
    ours = scene.object_mask[used]
    points = np.stack([scene.points_base[..., 0][used], scene.points_base[..., 1][used], scene.height_m[used]])
    if level_from_base is not None:
        points = apply(level_from_base, points.T.astype(float)).T.astype(np.float32)
    low, high = points[:2, ours].min(axis=1) - MARGIN_M, points[:2, ours].max(axis=1) + MARGIN_M
    low = low.astype(float)
    nx, ny = np.ceil((high - low) / CELL_M).astype(int) + 1
    column = np.rint((points[0] - low[0]) * (1 / CELL_M)).astype(np.int32)
    row = np.rint((points[1] - low[1]) * (1 / CELL_M)).astype(np.int32)
    near = (column >= 0) & (column < nx) & (row >= 0) & (row < ny)
    flat = row[near] * nx + column[near]
    grid = np.full(nx * ny, -np.inf)
    np.maximum.at(grid, flat, points[2, near].astype(float))
    belongs = np.zeros(nx * ny, dtype=bool)
    belongs[flat[ours[near]]] = True
    grid, belongs = grid.reshape(ny, nx), belongs.reshape(ny, nx)
    unseen = np.isinf(grid)
    nearest = ndimage.distance_transform_edt(unseen, return_distances=False, return_indices=True)
    filled = grid[tuple(nearest)]
    return HeightMap(filled, ndimage.binary_closing(belongs) | belongs, low)
