"""The points of all looks as one cloud, in the table's frame: of one look its pixels, of several their voxel averages.

A cloud and no truncated distance field: averages keep thin walls (docs/method.md has the figures).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from bus.transforms import from_rotation
from config.schema import Station
from perception.geometry.depth import moved
from perception.geometry.voxels import averaged
from perception.scene.look import LookOnTable
from perception.scene.normals import continued
from perception.scene.region import raised, within
from perception.scene.table import Table

_VOXEL_M = 0.002
_ALIKE = 0.2
"""A mean of normals that is shorter is of faces that look elsewhere: it is none."""
_BESIDE_M = 0.25
"""Points so far beside the pick region matter to nothing that is done in it; the table has the x and y of ``base``."""

Mask = npt.NDArray[np.bool_]
Points = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of the scene, all (n, ...).

    Attributes:
        points_table: (n, 3) [m], NaN = none. ``lab``: (n, 3) CIELAB of the raised ones, 0 elsewhere.
        is_raised: (n,) those that may belong to objects.
        weights: (n,) how many pixels are averaged in each. ``normals_table``: (n, 3) towards the cameras, of length 1,
            0 where none is known. Both None for one look, whose pixels the points are.
    """

    points_table: Points
    lab: Points
    is_raised: Mask
    weights: npt.NDArray[np.float64] | None = None
    normals_table: Points | None = None

    @cached_property
    def has_normal(self) -> Mask:
        """(n,) the points whose normal is known; none of one look's."""
        nothing = np.zeros(len(self.points_table), dtype=bool)
        return nothing if self.normals_table is None else np.asarray(self.normals_table.any(axis=1))

    @classmethod
    def of(cls, looks: Sequence[LookOnTable], table: Table, station: Station) -> Cloud:
        """Put the looks together."""
        if len(looks) == 1:
            (one,) = looks
            return cls(one.points_table.reshape(-1, 3), one.lab.reshape(-1, 3), one.is_raised.ravel())
        near = [np.flatnonzero(within(one.points_table, station, _BESIDE_M)) for one in looks]
        points = np.concatenate([one.points_table.reshape(-1, 3)[at] for one, at in zip(looks, near, strict=True)])
        other = np.concatenate([_colors_and_normals(one, table)[at] for one, at in zip(looks, near, strict=True)])
        points, other, count = averaged(points, other, _VOXEL_M)
        is_raised = raised(moved(points[None], table.base_from_table)[0], points[:, 2], station)
        length = np.linalg.norm(other[:, 3:], axis=1, keepdims=True)
        normals = other[:, 3:] / np.maximum(length, np.float32(1e-9))
        return cls(points, other[:, :3], is_raised, count, np.where(length > _ALIKE, normals, np.float32(0)))


def _colors_and_normals(one: LookOnTable, table: Table) -> Points:
    """(h * w, 6) CIELAB and normal of each pixel, 0 where there is none."""
    turn = from_rotation(table.table_from_base[:3, :3])
    normals = np.nan_to_num(moved(continued(one.look.view, one.look.surface, one.is_raised), turn))
    return np.concatenate([one.lab.reshape(-1, 3), normals.reshape(-1, 3)], axis=1)
