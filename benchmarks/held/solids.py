"""The true shapes of simulated objects, as the oracle of `benchmarks.heaps` takes them: convex parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from benchmarks.heaps.heap import FIXED, Heap, Part
from benchmarks.heaps.shapes import box_corners
from bus.transforms import apply
from config.scene import scene_boxes
from config.schema import Station

_AROUND, _ALONG = 24, 7
"""Points around a round primitive, and from its equator to its pole."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Thing:
    """An object: its name, and the corners (k, 3) [m] of its convex parts in the frame of its body."""

    name: str
    parts: tuple[Array, ...]


def things(model: mujoco.MjModel, objects: Mapping[str, str]) -> tuple[Thing, ...]:
    """Return the objects (free body -> name) of a compiled world."""
    return tuple(Thing(name, _parts(model, model.body(body).id)) for body, name in objects.items())


def _parts(model: mujoco.MjModel, root: int) -> tuple[Array, ...]:
    """Of every contact geom of the free body and the bodies fixed to it."""
    fresh = mujoco.MjData(model)
    mujoco.mj_kinematics(model, fresh)
    turn, place = fresh.xmat[root].reshape(3, 3), fresh.xpos[root]
    solid = np.flatnonzero((model.body_rootid[model.geom_bodyid] == root) & (model.geom_contype != 0))
    return tuple(
        (fresh.geom_xpos[geom] + corners(model, int(geom)) @ fresh.geom_xmat[geom].reshape(3, 3).T - place) @ turn
        for geom in solid
    )


def corners(model: mujoco.MjModel, geom: int) -> Array:
    """Return points (k, 3) whose convex hull is the geom's shape, nearly where it is round, in its own frame."""
    kind, size = model.geom_type[geom], np.array(model.geom_size[geom])
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        first, count = model.mesh_vertadr[model.geom_dataid[geom]], model.mesh_vertnum[model.geom_dataid[geom]]
        return np.asarray(model.mesh_vert[first : first + count], dtype=np.float64)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return box_corners(2 * size, np.zeros(3))
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return np.concatenate([_ring(size[0], z) for z in (-size[1], size[1])])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return np.concatenate([_ball((size[0],) * 3) + z * np.eye(3)[2] for z in (-size[1], size[1])])
    return _ball((size[0],) * 3 if kind == mujoco.mjtGeom.mjGEOM_SPHERE else size)


def _ring(radius_m: float, z_m: float) -> Array:
    turns = 2 * np.pi * np.arange(_AROUND) / _AROUND
    return np.stack([radius_m * np.cos(turns), radius_m * np.sin(turns), np.full(_AROUND, z_m)], axis=1)


def _ball(radii_m: Sequence[float] | Array) -> Array:
    rises = np.linspace(-np.pi / 2, np.pi / 2, 2 * _ALONG + 1)
    unit = np.concatenate([_ring(float(np.cos(rise)), float(np.sin(rise))) for rise in rises])
    return np.asarray(unit * np.array(radii_m))


def in_tray(station: Station, base_from_body: Array) -> int:
    """Return how many of the bodies at (n, 4, 4) have their origin over the tray."""
    tray = station.scene.tray
    off_m = np.abs(base_from_body[:, :2, 3] - tray.center_m[:2])
    return int(((off_m <= np.array(tray.size_m[:2]) / 2) & (base_from_body[:, 2:3, 3] > 0)).all(axis=1).sum())


def scene_of(station: Station, lying: Sequence[Thing], base_from_body: Array, seed: int) -> Heap:
    """Return what lies in the pick region, walls and tray as the oracle takes it; no picture of it.

    Args:
        base_from_body: (n, 4, 4) of every thing.
    """
    x_min, x_max, y_min, y_max = station.scene.pick_region_m
    names: list[str] = []
    parts: list[Part] = []
    for one, pose in zip(lying, base_from_body, strict=True):
        placed = [apply(pose, part) for part in one.parts]
        x, y, z = np.concatenate(placed).mean(axis=0)
        if x_min < x < x_max and y_min < y < y_max and z > 0:
            parts += [Part(part, len(names)) for part in placed]
            names.append(one.name)
    for box in scene_boxes(station.scene):
        if box.name != station.scene.table.name:  # that is a plane
            parts.append(Part(box_corners(np.array(box.size_m), np.array(box.center_m)), FIXED))
    nothing = np.zeros((0, 0, 3), np.uint8), np.zeros((0, 0), np.float32)
    kind = "bin" if station.scene.bins else "table"
    return Heap(len(names), seed, kind, "", tuple(names), *nothing, np.eye(4), np.eye(4), np.eye(4), tuple(parts))
