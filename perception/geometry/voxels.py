"""Averages of points over the cubes of a grid, bit for bit the same each time."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Points = npt.NDArray[np.float32]
Indices = npt.NDArray[np.int64]

_LONGEST_BITS = 62


def averaged(points: Points, other: Points, voxel_m: float) -> tuple[Points, Points, npt.NDArray[np.float64]]:
    """Return the means of points (n, 3) [m] and of what else is known of each (n, k), in cubes of side ``voxel_m``.

    Returns: the means of both, (m, 3) and (m, k), by z, then y, then x; and how many points are averaged in each (m,).

    Raises: ValueError: a point is not finite, or the points lie too far apart for the size of the cubes.
    """
    if not len(points):
        return points, other, np.zeros(0)
    order, first = _voxels(points, voxel_m)
    count = np.diff(np.append(first, len(points)))
    means = (np.add.reduceat(column[order], first) / count[:, None] for column in (points, other))
    mean_points, mean_other = (one.astype(np.float32) for one in means)
    return mean_points, mean_other, count.astype(np.float64)


def _voxels(points: Points, voxel_m: float) -> tuple[Indices, Indices]:
    """The order (n,) that brings points (n, 3) of a cube together, and where each cube (m,) begins in it."""
    if not np.isfinite(points).all():
        raise ValueError("a point of a cloud is not finite")
    cells = np.floor(points / np.float32(voxel_m)).astype(np.int64)
    cells -= cells.min(axis=0)
    nx, ny, nz = (int(side) + 1 for side in cells.max(axis=0))
    bits = len(points).bit_length()
    if (nx * ny * nz).bit_length() + bits > _LONGEST_BITS:
        raise ValueError(f"points spread over {nx} x {ny} x {nz} voxels are too many to sort")
    key = (cells[:, 2] * ny + cells[:, 1]) * nx + cells[:, 0]
    # sorting key and place as one number is a stable sort, and five times as fast as one
    packed = np.sort((key << bits) | np.arange(len(points)))
    key = packed >> bits
    return packed & ((1 << bits) - 1), np.flatnonzero(np.append(True, key[1:] != key[:-1]))
