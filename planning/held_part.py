"""The part of a thing that hangs in the hand for certain: it is connected to what is between the pads.

Perception takes touching pieces of one colour for one thing. As a whole it may be a heap, in which no hand has room and
which fits through nowhere. Frames: docs/frames.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from bus.arrays import Transform
from bus.transforms import apply, inverse
from planning.height_field import CELL_M, Sight

_APART_M = 2 * CELL_M
"""Neighbours in the image that lie so far apart are not connected: on one surface they are nearer than a cell."""
_BESIDE_M, _PAD_M, _ABOVE_M, _BELOW_M = 0.003, 0.010, 0.05, 0.02
"""Between the pads: so far beyond either, to either side across them, and above and below the tcp."""
_FEWEST = 3
_MUCH_LESS = 0.85
"""A part of more than this share of the thing is the thing."""

Mask = npt.NDArray[np.bool_]


def held_parts(sights: Sequence[Sight], base_from_tcp: Transform, width_m: float) -> list[Sight] | None:
    """Return the sights with only the part of the target that a grasp holds; None when that is nearly all, or nothing.

    Args:
        base_from_tcp: (4, 4) of the grasp. ``width_m``: of what is between the pads.
    """
    tcp_from_base = inverse(np.asarray(base_from_tcp))
    parts = [replace(sight, target=_held(sight, tcp_from_base, width_m)) for sight in sights]
    held, whole = (sum(int(sight.target.sum()) for sight in some) for some in (parts, sights))
    return parts if 0 < held < _MUCH_LESS * whole else None


def _held(sight: Sight, tcp_from_base: Transform, width_m: float) -> Mask:
    """The pixels (H, W) of the target that are connected to those between the pads."""
    part = np.zeros_like(sight.target)
    if not sight.target.any():
        return part
    number = _components(sight)
    x, y, z = np.moveaxis(apply(tcp_from_base, sight.points_base[sight.target].astype(float)), -1, 0)
    between = (abs(x) < _PAD_M) & (abs(y) < width_m / 2 + _BESIDE_M) & (z < _BELOW_M) & (z > -_ABOVE_M)
    count = np.bincount(number[between], minlength=int(number.max()) + 1)
    part[sight.target] = (count >= _FEWEST)[number]
    return part


def _components(sight: Sight) -> npt.NDArray[np.int32]:
    """The number (n,) of the connected part of each of the target's n pixels."""
    index = np.full(sight.target.shape, -1, dtype=np.int32)
    count = int(sight.target.sum())
    index[sight.target] = np.arange(count, dtype=np.int32)
    pairs = []
    for one, other in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        apart_m = np.linalg.norm(sight.points_base[one] - sight.points_base[other], axis=-1)
        near = (index[one] >= 0) & (index[other] >= 0) & (apart_m < _APART_M)  # NaN compares false
        pairs.append(np.stack([index[one][near], index[other][near]]))
    first, second = np.concatenate(pairs, axis=1)
    graph = coo_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1])
