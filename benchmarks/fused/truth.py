"""Distances of points from the true surface: convex parts on a level table. Frame: ``base``; in metres."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from benchmarks.heaps.clipping import half_spaces

_AROUND_M = 0.015
"""Points farther than this from a part's box have another nearest, or are that wrong."""
_ON_TABLE_M = 0.006
"""A point truly nearest to the table, or so low, is not an object's."""

Array = npt.NDArray[np.float64]


def distances_m(points: npt.NDArray[np.float32], parts: Sequence[Array]) -> Array:
    """Distances (m,) [m] of those points (n, 3) that belong to objects from the surface of all parts together.

    Beside an edge the distance is that from the nearer facet's plane. A point far from all parts counts by its height
    above the table, if that is less.
    """
    exact = np.asarray(points, dtype=float)
    outside_m = np.full(len(exact), np.inf)
    for corners in parts:
        near = ((exact > corners.min(axis=0) - _AROUND_M) & (exact < corners.max(axis=0) + _AROUND_M)).all(axis=1)
        planes = half_spaces(corners)
        signed_m = (exact[near] @ planes[:, :3].T + planes[:, 3]).max(axis=1)
        outside_m[near] = np.minimum(outside_m[near], signed_m)
    is_object = (exact[:, 2] > _ON_TABLE_M) & (np.abs(outside_m) < np.abs(exact[:, 2]))
    far = ~np.isfinite(outside_m) & (exact[:, 2] > _ON_TABLE_M)
    return np.concatenate([np.abs(outside_m[is_object]), np.minimum(exact[far, 2], _AROUND_M)])
