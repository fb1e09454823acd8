"""Rigid bodies made of convex parts: what collides, what is rendered and what is judged is the same. In metres."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull

from bus.errors import ConfigError
from drivers.sim.mjcf import attach
from drivers.sim.objects import object_file, object_names

LEAST_SIDE_M, LONGEST_SIDE_M = 0.075, 0.240
"""Of the objects used: the least side fits the jaw, and the longest leaves room in the pick region."""
_MOST_CORNERS = 128
"""More corners than this cost collision and judge much, and move no surface by more than half a millimetre."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Shape:
    """A rigid body.

    Attributes:
        parts: corners (k, 3) [m] of each convex part, in the body's frame.
        density_kg_m3: of every part.
    """

    name: str
    parts: tuple[Array, ...]
    density_kg_m3: float = 1250.0


def box(name: str, size_m: tuple[float, float, float], at_m: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Shape:
    """Return a box of full sizes about ``at_m``, wood-like."""
    return Shape(name, (box_corners(np.array(size_m), np.array(at_m)),), 700.0)


def box_corners(size_m: Array, at_m: Array) -> Array:
    """Return the corners (8, 3) of an axis-aligned box of full sizes (3,) about ``at_m`` (3,)."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    return np.asarray(at_m + signs * size_m / 2)


@cache
def read_shapes(folder: Path) -> tuple[Shape, ...]:
    """Return the convex contact parts of every object of ``folder`` that is small enough, sorted by name.

    Raises:
        ConfigError: there is no such folder, or it holds no object that can be used.
    """
    if not folder.is_dir():
        raise ConfigError(f"There is no folder {folder}.", "Name the objects' folder (object_sim) with --objects.")
    shapes = tuple(shape for name in object_names(folder) if _is_usable(shape := _read(folder, name)))
    if not shapes:
        raise ConfigError(f"No object of {folder} is small enough.", "Name the folder object_sim with --objects.")
    return shapes


def _is_usable(shape: Shape) -> bool:
    side_m = np.sort(np.ptp(np.concatenate(shape.parts), axis=0))
    return bool(side_m[0] < LEAST_SIDE_M and side_m[2] < LONGEST_SIDE_M)


def _read(folder: Path, name: str) -> Shape:
    spec = mujoco.MjSpec()
    attach(spec, object_file(folder, name), "object")
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    parts = []
    for geom in np.flatnonzero(model.geom_contype):
        mesh = model.geom_dataid[geom]
        if mesh < 0:
            raise ConfigError(f"The object {name!r} has a contact geom that is no mesh.", "Use object_sim.")
        first = model.mesh_vertadr[mesh]
        corners = np.asarray(model.mesh_vert[first : first + model.mesh_vertnum[mesh]], dtype=np.float64)
        parts.append(_few(data.geom_xpos[geom] + corners @ data.geom_xmat[geom].reshape(3, 3).T))
    return Shape(name, tuple(parts))


def _few(corners: Array) -> Array:
    """Return the corners of the convex hull; of too many, those farthest along evenly spread directions."""
    hull = corners[ConvexHull(corners).vertices]
    if len(hull) <= _MOST_CORNERS:
        return np.asarray(hull)
    index = np.arange(2 * _MOST_CORNERS) + 0.5
    z, turn = 1 - index / _MOST_CORNERS, np.pi * (1 + 5**0.5) * index
    directions = np.stack([np.cos(turn) * np.sqrt(1 - z**2), np.sin(turn) * np.sqrt(1 - z**2), z], axis=1)
    return np.asarray(hull[np.unique((hull @ directions.T).argmax(axis=0))])
