"""Whether a scene can be picked from any side: the oracle's search along leaning and level approaches, too.

A grasp from a side must also be in the arm's reach: half of the sides of a table are not.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull

from benchmarks.heaps.candidates import Truth
from benchmarks.heaps.heap import FIXED, Heap
from benchmarks.heaps.judge import Judge
from benchmarks.heaps.oracle import Robust, is_robust
from benchmarks.heaps.plan import station_of
from bus.transforms import apply, from_rotation, inverse
from config.schema import Station
from planning.candidates import configurations, twins
from planning.kinematics import FR3_ARM
from planning.robot import Robot
from planning.scene import Scene

_TILTS_DEG, _AROUND_DEG = (90.0, 60.0, 30.0), tuple(45.0 * turn for turn in range(8))
_FACES, _APART_DEG = 8, 10.0
_LOWEST, _STEEPEST = -0.05, float(np.cos(np.deg2rad(10)))
"""Vertical components of the directions from which a face is approached: from the table's level to nearly above."""
_ON_FACES, _ANYWHERE = 250, 2500
_MOST_JUDGED = 250
"""For each direction."""
_EXAMINED = 40
_LOWERED_M = 0.02
"""The arm's obstacles lie so much lower than the station says, as the table may; the judge has checked the hand."""

Array = npt.NDArray[np.float64]


def search(heap: Heap, along: Sequence[Array] | None = None) -> Robust:
    """Try each direction in turn, until a grasp is robust and in reach.

    Args:
        along: as `directions` returns; None = all of those.
    """
    judge, rng = Judge.of(heap), np.random.default_rng([heap.seed, heap.n, 7])
    judged = 0
    for table_from_side in directions(heap) if along is None else along:
        truth = Truth(heap, table_from_side)
        poses = truth.poses(truth.on_faces(_ON_FACES, rng).and_(truth.anywhere(_ANYWHERE, rng)))
        for base_from_tcp, opening_m in poses[:_MOST_JUDGED]:
            judged += 1
            if is_robust(judge, base_from_tcp, opening_m) and in_reach(heap.kind, base_from_tcp):
                return Robust(base_from_tcp, opening_m, judged)
    return Robust(None, float("nan"), judged)


def directions(heap: Heap) -> list[Array]:
    """Return ``table_from_side`` (4, 4) of every approach: square to the largest faces, then evenly spread."""
    tilts, around = (one.ravel() for one in np.meshgrid(np.deg2rad(_TILTS_DEG), np.deg2rad(_AROUND_DEG)))
    spread = np.stack([np.sin(tilts) * np.cos(around), np.sin(tilts) * np.sin(around), np.cos(tilts)], axis=1)
    return [_facing(up) for up in np.concatenate([_faces(heap), spread])]


def _facing(against: Array) -> Array:
    """The pose (4, 4) at the table's origin of a frame whose z is along ``against`` (3,); its x is level."""
    level = np.cross([0.0, 0.0, 1.0], against)
    x = level / np.linalg.norm(level)
    return from_rotation(np.stack([x, np.cross(against, x), against], axis=1))


def _faces(heap: Heap) -> Array:
    """The outward normals (k, 3) in ``table`` of the bodies' largest faces that can be approached; k <= 8."""
    normals, areas = (np.concatenate(one) for one in zip(*map(_facets, _in_table(heap)), strict=True))
    able = (normals[:, 2] > _LOWEST) & (normals[:, 2] < _STEEPEST)
    normals, areas = normals[able], areas[able]
    normals[:, 2] = np.maximum(normals[:, 2], 0.0)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    chosen: list[Array] = []
    while len(normals) and len(chosen) < _FACES:
        near = normals @ normals.T > np.cos(np.deg2rad(_APART_DEG))
        largest = int((near @ areas).argmax())
        chosen.append(normals[largest])
        normals, areas = normals[~near[largest]], areas[~near[largest]]
    return np.array(chosen).reshape(-1, 3)


def _in_table(heap: Heap) -> list[Array]:
    table_from_base = inverse(heap.base_from_table)
    return [apply(table_from_base, part.corners) for part in heap.parts if part.body != FIXED]


def _facets(corners: Array) -> tuple[Array, Array]:
    """The triangles' outward normals (k, 3) and areas (k,)."""
    hull = ConvexHull(corners)
    a, b, c = np.moveaxis(hull.points[hull.simplices], 1, 0)
    return hull.equations[:, :3], np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


# --- reach ------------------------------------------------------------------------------------------------------------


def in_reach(kind: str, base_from_tcp: Array) -> bool:
    """Whether some configuration of the arm, clear of table and walls, brings the hand there; either way around."""
    station, scene = station_of(kind), _obstacles(kind)
    capture_rad = np.array(station.arm.capture_q_rad)
    for index, (q_rad, _) in enumerate(configurations(FR3_ARM, twins(base_from_tcp), capture_rad)):
        if scene.collision(q_rad, station.hand.max_width_m) is None:
            return True
        if index == _EXAMINED:
            break
    return False


@cache
def _obstacles(kind: str) -> Scene:
    station: Station = station_of(kind)
    robot = Robot(station)
    boxes = [
        box.model_copy(update={"center_m": (*box.center_m[:2], box.center_m[2] - _LOWERED_M)})
        for box in Scene.of(robot, station).boxes
    ]
    return Scene.of(robot, station, boxes=boxes)
