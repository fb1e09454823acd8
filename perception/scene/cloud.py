"""The points of all looks as one cloud, in the table's frame: of one look its pixels, of several their voxel averages.

A cloud and no truncated distance field: averages keep thin walls (docs/method.md has the figures).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from config.schema import Station
from perception.geometry.depth import moved
from perception.geometry.voxels import averaged
from perception.scene.look import LookOnTable
from perception.scene.region import raised
from perception.scene.table import Table

_VOXEL_M = 0.002
_BESIDE_M = 0.25
"""Points so far beside the pick region matter to nothing that is done in it."""

Mask = npt.NDArray[np.bool_]
Points = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of the scene, all (n, ...).

    Attributes:
        points_table: (n, 3) [m], NaN = none. ``lab``: (n, 3) CIELAB of the raised ones, 0 elsewhere.
        is_raised: (n,) those that may belong to objects.
        weights: (n,) how many pixels are averaged in each; None for one look, whose pixels they are.
    """

    points_table: Points
    lab: Points
    is_raised: Mask
    weights: npt.NDArray[np.float64] | None

    @classmethod
    def of(cls, looks: Sequence[LookOnTable], table: Table, station: Station) -> Cloud:
        """Put the looks together."""
        if len(looks) == 1:
            (one,) = looks
            return cls(one.points_table.reshape(-1, 3), one.lab.reshape(-1, 3), one.is_raised.ravel(), None)
        near = [_near(one.points_table, station) for one in looks]
        points = np.concatenate([one.points_table.reshape(-1, 3)[at] for one, at in zip(looks, near, strict=True)])
        lab = np.concatenate([one.lab.reshape(-1, 3)[at] for one, at in zip(looks, near, strict=True)])
        points, lab, count = averaged(points, lab, _VOXEL_M)
        return cls(points, lab, raised(moved(points[None], table.base_from_table)[0], points[:, 2], station), count)


def _near(points_table: Points, station: Station) -> npt.NDArray[np.intp]:
    """Flat indices of the points (h, w, 3) with depth in and around the pick region; the table has ``base``'s x, y."""
    x_min, x_max, y_min, y_max = station.scene.pick_region_m
    x, y = points_table[..., 0], points_table[..., 1]
    inside = (x > x_min - _BESIDE_M) & (x < x_max + _BESIDE_M) & (y > y_min - _BESIDE_M) & (y < y_max + _BESIDE_M)
    return np.flatnonzero(inside)
