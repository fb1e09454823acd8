"""Leans the hand with the faces that its pads touch: the wall of a bowl, or a wedge, is closed on square to them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from bus.messages import Instance
from bus.transforms import from_rotation
from config.schema import Station
from perception.grasps.closing import Closings, close
from perception.grasps.faces import Surfaces, across_faces
from perception.grasps.rank import graded
from perception.grasps.search import tested
from perception.scene.scene import Scene

_BEST, _APART_M, _MOST = 8, 0.010, 4
"""Of each direction so many closings, so far apart, are looked at; of all, so many are squared."""
_LEANS_RAD, _MOST_RAD = float(np.deg2rad(4)), float(np.deg2rad(60))
_LEVEL_AT_MOST = float(np.cos(np.deg2rad(80)))
"""An approach that leans more than this from the table's normal is left to the search of the sides."""
_TURNS_RAD, _SIDES_M, _DOWN_M = np.deg2rad([-8.0, 0.0, 8.0]), (-0.004, 0.0, 0.004), (-0.004, 0.0, 0.004)
_TESTED = 30

Array = npt.NDArray[np.float64]
Found = tuple[Closings, Transform]
"""Closings, and the level frame (4, 4) in ``base`` that they are given in."""


def squared(
    found: Sequence[Found], scene: Scene, instances: tuple[Instance, ...], number: int, station: Station
) -> Iterator[Found]:
    """Yield the best closings on a thing whose faces lean, once more with the hand leaning as they do."""
    for base_from_contact in _leaning(found, scene, number):
        heights, base_from_level = scene.along(base_from_contact, number)
        up_m = float(base_from_level[:3, 2] @ (base_from_contact - base_from_level)[:3, 3])
        turns_rad, sides_m, downs_m = np.array(list(product(_TURNS_RAD, _SIDES_M, _DOWN_M))).T
        centers_m = np.column_stack([np.zeros(len(sides_m)), sides_m])
        closings = tested(close(heights, centers_m, turns_rad, up_m - downs_m, station), heights, station, _TESTED)
        closings = across_faces(graded(closings, instances), scene, base_from_level)
        ours = closings.on(number)
        if len(ours.score):
            yield ours, base_from_level


def _leaning(found: Sequence[Found], scene: Scene, number: int) -> list[Transform]:
    """Poses (4, 4) in ``base`` at the best closings on what leans: x across its faces, z against the approach."""
    leaning: list[tuple[float, Transform]] = []
    for closings, base_from_level in found:
        surfaces = Surfaces.of(scene, base_from_level)
        if surfaces is None:
            return []
        ours = closings.on(number)
        for index in ours.distinct(_BEST, _APART_M):
            lean_rad = surfaces.touched(ours, index).lean_rad
            if lean_rad is not None and _LEANS_RAD < abs(lean_rad) < _MOST_RAD:
                base_from_contact = base_from_level @ _leant(ours, index, lean_rad)
                if scene.table.base_from_table[:3, 2] @ base_from_contact[:3, 2] > _LEVEL_AT_MOST:
                    leaning.append((float(ours.score[index]), base_from_contact))
    return [pose for _, pose in sorted(leaning, key=lambda one: -one[0])[:_MOST]]


def _leant(closings: Closings, index: int, lean_rad: float) -> Transform:
    """level_from_contact (4, 4) between the pads: x is the closing axis, turned up by ``lean_rad``."""
    heading = float(closings.heading_rad[index])
    along, up = np.array([np.cos(heading), np.sin(heading), 0.0]), np.array([0.0, 0.0, 1.0])
    x = np.cos(lean_rad) * along + np.sin(lean_rad) * up
    z = np.cos(lean_rad) * up - np.sin(lean_rad) * along
    return from_rotation(
        np.column_stack([x, np.cross(z, x), z]), [*closings.center_m[index], float(closings.slice_m[index])]
    )
