"""An orthographic height map of the table around the object, so that the camera's tilt does not matter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from bus.arrays import Transform
from perception.lift import transform
from perception.segment import Scene

CELL_M = 0.002
_MARGIN_M = 0.13
"""Around the object: room for the palm (0.2 m long)."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class HeightMap:
    """Heights above the table on a grid of ``base`` x, y.

    Attributes:
        height_m: (ny, nx), every cell filled (unseen ones from their nearest neighbour).
        is_object: (ny, nx).
        origin_m: (x, y) of the centre of cell [0, 0].
    """

    height_m: Array
    is_object: npt.NDArray[np.bool_]
    origin_m: Array

    def at(self, x: Array, y: Array) -> Array:
        """Heights at points of any shape; the table outside the map."""
        column = np.rint((x - self.origin_m[0]) / CELL_M).astype(int)
        row = np.rint((y - self.origin_m[1]) / CELL_M).astype(int)
        ny, nx = self.height_m.shape
        inside = (column >= 0) & (column < nx) & (row >= 0) & (row < ny)
        return np.where(inside, self.height_m[row.clip(0, ny - 1), column.clip(0, nx - 1)], 0.0)

    def xy_m(self, rows: npt.NDArray[np.int64], columns: npt.NDArray[np.int64]) -> Array:
        """(n, 2) positions of cells."""
        return np.stack([columns * CELL_M + self.origin_m[0], rows * CELL_M + self.origin_m[1]], axis=1)


def height_map(scene: Scene, level_from_base: Transform | None = None) -> HeightMap:
    """The highest point seen in every cell.

    Args:
        level_from_base: look along this frame's -z instead of the table's; heights are then its z.
    """
    points = np.concatenate([scene.points_base[..., :2], scene.height_m[..., None]], axis=2)
    if level_from_base is not None:
        points = transform(level_from_base, points.reshape(-1, 3)).reshape(points.shape)
    objects = points[scene.object_mask & np.isfinite(points[..., 2])]
    low, high = objects[:, :2].min(axis=0) - _MARGIN_M, objects[:, :2].max(axis=0) + _MARGIN_M
    nx, ny = np.ceil((high - low) / CELL_M).astype(int) + 1
    with np.errstate(invalid="ignore"):
        seen = ((points[..., :2] > low) & (points[..., :2] < high)).all(axis=2)
    cell = np.rint((points[seen][:, :2] - low) / CELL_M).astype(int)
    flat = cell[:, 1] * nx + cell[:, 0]
    grid = np.full(nx * ny, -np.inf)
    np.maximum.at(grid, flat, points[seen][:, 2])
    belongs = np.zeros(nx * ny, dtype=bool)
    belongs[flat[scene.object_mask[seen]]] = True
    grid, belongs = grid.reshape(ny, nx), belongs.reshape(ny, nx)
    unseen = np.isinf(grid)
    nearest = ndimage.distance_transform_edt(unseen, return_distances=False, return_indices=True)
    filled = grid[tuple(nearest)]
    return HeightMap(filled, ndimage.binary_closing(belongs) | belongs, low)
