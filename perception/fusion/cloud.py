"""One cloud of several views: the points of each voxel averaged, bit for bit the same each time. In ``base``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Points = npt.NDArray[np.float32]
Indices = npt.NDArray[np.int64]

_LONGEST_BITS = 62


@dataclass(frozen=True, eq=False)
class Part:
    """Points of one view, for example those of a depth image's pixels in a mask.

    Attributes:
        points_base: (n, 3) [m], finite.
        normals_base: (n, 3) towards the camera, NaN = unknown.
        lab: (n, 3) CIELAB colours.
    """

    points_base: Points
    normals_base: Points
    lab: Points


@dataclass(frozen=True, eq=False)
class Cloud:
    """The voxels in which something was seen, ordered by z, then y, then x.

    Attributes:
        points_base: (n, 3) [m], the mean of the points in each voxel.
        normals_base: (n, 3) unit normals, NaN where no point has one.
        lab: (n, 3) CIELAB, the mean.
        views: (n,) how many views saw something in the voxel.
    """

    points_base: Points
    normals_base: Points
    lab: Points
    views: npt.NDArray[np.uint8]


def averaged(parts: Sequence[Part], voxel_m: float) -> Cloud:
    """Average the points of all views in voxels of edge ``voxel_m``, whose grid is that of ``base``.

    Raises: ValueError: a point is not finite, or the points lie too far apart for the size of the voxels.
    """
    points = np.concatenate([np.zeros((0, 3), np.float32), *(part.points_base for part in parts)])
    if not len(points):
        return Cloud(points, points, points, np.zeros(0, np.uint8))
    order, first = _voxels(points, voxel_m)
    count = np.diff(np.append(first, len(points)))[:, None]
    normals = np.concatenate([part.normals_base for part in parts])
    lab = np.concatenate([part.lab for part in parts])
    view = np.repeat(np.arange(len(parts)), [len(part.points_base) for part in parts])[order]
    # inside a voxel the points keep their order, so those of one view follow each other
    is_new = np.append(True, view[1:] != view[:-1])
    is_new[first] = True
    return Cloud(
        (np.add.reduceat(points[order], first) / count).astype(np.float32),
        _directions(np.add.reduceat(np.nan_to_num(normals[order]), first)),
        (np.add.reduceat(lab[order], first) / count).astype(np.float32),
        np.add.reduceat(is_new.astype(np.uint8), first),
    )


def _voxels(points: Points, voxel_m: float) -> tuple[Indices, Indices]:
    """The order (n,) that brings points (n, 3) of a voxel together, and where each voxel (m,) begins in it."""
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


def _directions(sums: Points) -> Points:
    """Unit vectors (n, 3), NaN where there is nothing to scale."""
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.asarray(sums / np.where(length > 0, length, np.float32(np.nan)))
