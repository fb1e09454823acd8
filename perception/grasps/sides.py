"""Searches one thing for grasps from its sides: along directions of the upper hemisphere besides the vertical.

It needs several looks: from above alone, a thing's sides are not seen, and what was not seen is not free. One look that
is taken aslant shows one side: there the hand leans towards the camera.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from bus.messages import Instance
from bus.transforms import apply, from_rotation
from config.schema import Station
from perception.grasps.closing import Closings
from perception.grasps.faces import across_faces
from perception.grasps.rank import graded
from perception.grasps.search import search
from perception.scene.scene import Scene

_LEANING_DEG, _LEVEL_DEG = 35.0, 75.0
_HIGH_M = 0.04
"""Of a lower thing the nearly level hand, which is 64 mm thick, finds nothing but the table in its way."""
_SIGHT = (0.5, 1.0)
"""Shares of the camera's lean by which the hand leans, too."""
_TURNS_DEG = (0.0, 45.0, -45.0, 90.0, -90.0)
"""Headings of the approach, from the direction that leads away from the arm's base: from beyond it hardly reaches."""

Array = npt.NDArray[np.float64]


def search_sides(
    scene: Scene, instances: tuple[Instance, ...], number: int, station: Station
) -> Iterator[tuple[Closings, Transform]]:
    """Closings on one thing from each direction, and the level frame (4, 4) in ``base`` that they are given in."""
    if len(scene.looks) == 1 and not scene.is_aslant:
        return
    levels = _along_sight if scene.is_aslant else _levels
    for base_from_level in levels(scene, instances[number - 1]):
        heights, base_from_level = scene.along(base_from_level, number)
        found = across_faces(graded(search(heights, station, base_from_level), instances), scene, base_from_level)
        ours = found.on(number)
        if len(ours.score):
            yield ours, base_from_level


def _levels(scene: Scene, thing: Instance) -> Iterator[Transform]:
    """Level frames (4, 4) about a thing, x along the table."""
    away_rad = float(np.arctan2(thing.top_m[1], thing.top_m[0]))
    base_from_table = scene.table.base_from_table
    place_table = apply(scene.table.table_from_base, np.asarray(thing.top_m)[None])[0] * np.array([1.0, 1.0, 0.0])
    is_high = thing.size_m[2] > _HIGH_M
    for tilt_deg in (_LEANING_DEG, _LEVEL_DEG) if is_high else (_LEANING_DEG,):
        for turn_deg in _TURNS_DEG:
            yield base_from_table @ from_rotation(
                _facing(np.radians(tilt_deg), away_rad + np.radians(turn_deg)), place_table
            )


def _along_sight(scene: Scene, thing: Instance) -> Iterator[Transform]:
    """Level frames (4, 4) about a thing that one camera sees aslant: a hand that leans as it does meets less unseen."""
    table_from_base = scene.table.table_from_base
    camera, top = apply(table_from_base, np.stack([scene.view.base_from_depth[:3, 3], np.asarray(thing.top_m)]))
    sight = top - camera
    heading_rad = float(np.arctan2(sight[1], sight[0]))
    tilt_rad = float(np.arctan2(np.hypot(sight[0], sight[1]), -sight[2]))
    place = top * np.array([1.0, 1.0, 0.0])
    for share in _SIGHT:
        yield scene.table.base_from_table @ from_rotation(_facing(share * tilt_rad, heading_rad), place)


def _facing(tilt_rad: float, heading_rad: float) -> Array:
    """Rotation (3, 3): z against an approach that leans by ``tilt_rad`` from straight down towards ``heading_rad``."""
    approach = np.array(
        [np.sin(tilt_rad) * np.cos(heading_rad), np.sin(tilt_rad) * np.sin(heading_rad), -np.cos(tilt_rad)]
    )
    x = np.array([-np.sin(heading_rad), np.cos(heading_rad), 0.0])
    return np.column_stack([x, np.cross(-approach, x), -approach])
