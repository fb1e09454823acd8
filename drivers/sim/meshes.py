"""Objects of which there is only a mesh: ``NAME.obj``, ``NAME.stl`` or ``NAME.ply``, in metres, its z up.

A mesh collides as its convex hull; as convex parts that follow its hollows where ``coacd`` is installed.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from bus.errors import ConfigError

SUFFIXES = (".obj", ".stl", ".ply")
"""Of a mesh's file; CAD programs write them in capitals, too."""
CONTACT_GROUP = 3
"""The group of convex contact parts of an object that also has a visual mesh."""
_VISUAL_GROUP = 2
_DENSITY_KG_M3 = 500.0
"""Of what collides: between hollow plastic and wood."""
_SMALLEST_M = 1e-3
_DECOMPOSED: dict[str, Any] = {
    "threshold": 0.08,
    "preprocess_resolution": 30,
    "resolution": 1000,
    "mcts_iterations": 30,
    "mcts_nodes": 10,
    "mcts_max_depth": 2,
    "decimate": True,
    "max_ch_vertex": 64,
    "seed": 0,
}
"""Of ``coacd``: a bowl is 25 parts after 7 s, where its own defaults take a minute for 51."""
_RGBA = (0.72, 0.66, 0.55, 1.0)

Faces = tuple[npt.NDArray[np.float64], npt.NDArray[np.int32]]
"""Corners (n, 3) and triangles (m, 3)."""


def mesh_object(file: Path, *, in_parts: bool) -> mujoco.MjSpec:
    """Return a model with one body that looks like the mesh of ``file``.

    Args:
        in_parts: it collides as convex parts, if they can be made here, which takes seconds; else as its hull.

    Raises:
        ConfigError: the file is no mesh.
    """
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="object")
    parts = _convex_parts(file, file.stat().st_mtime_ns) if in_parts and find_spec("coacd") else ()
    seen = _add(spec, "seen", read_mesh(file))
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=seen, rgba=_RGBA, density=_DENSITY_KG_M3,
                  group=_VISUAL_GROUP)  # fmt: skip
    for index, part in enumerate(parts):
        touched = _add(spec, f"part-{index}", part)
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=touched, density=_DENSITY_KG_M3, group=CONTACT_GROUP)
    return spec


def _add(spec: mujoco.MjSpec, name: str, faces: Faces) -> str:
    mesh = spec.add_mesh(name=name, uservert=faces[0].ravel(), userface=faces[1].ravel())
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX  # scans have holes
    return name


def is_mesh(file: Path) -> bool:
    """Return whether a file is a mesh, by its name."""
    return file.suffix.lower() in SUFFIXES


def read_mesh(file: Path) -> Faces:
    """Return the mesh of ``file``. Raises: ConfigError."""
    corners, triangles = _read_ply(file) if file.suffix.lower() == ".ply" else _read_with_mujoco(file)
    if not np.isfinite(corners).all():
        raise _no_mesh(file, "it has a corner that is not a finite number")
    if np.ptp(corners, axis=0).max() < _SMALLEST_M:
        raise _no_mesh(file, f"it is only {np.ptp(corners, axis=0).max():.2g} m large")
    if triangles.min(initial=0) < 0 or triangles.max(initial=0) >= len(corners):
        raise _no_mesh(file, "a triangle of it has a corner that is not there")
    return corners, triangles


def _read_with_mujoco(file: Path) -> Faces:
    spec = mujoco.MjSpec()
    mesh = spec.add_mesh(name="mesh", file=str(file.resolve()))
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="mesh")
    try:
        model: mujoco.MjModel = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise _no_mesh(file, " ".join(str(error).split()).removeprefix("Error: ").rstrip(".")) from error
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.mesh_quat[0])  # MuJoCo centres a mesh, and turns it to its main axes
    corners = np.asarray(model.mesh_vert, dtype=np.float64) @ turn.reshape(3, 3).T + model.mesh_pos[0]
    return corners, np.asarray(model.mesh_face, dtype=np.int32)


def _read_ply(file: Path) -> Faces:
    """Raises: ConfigError, also where ``trimesh`` is not installed: neither MuJoCo nor OpenCV reads any PLY safely."""
    try:
        trimesh = import_module("trimesh")
    except ImportError as error:
        advice = "Install vlad-cell[meshes], or save it as OBJ or binary STL."
        raise ConfigError(f"The mesh {file} cannot be read here: {error}.", advice) from error
    try:
        mesh = trimesh.load(str(file), force="mesh", process=False)
        corners, triangles = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32)
    except Exception as error:  # what trimesh raises for a file that is none varies
        raise _no_mesh(file, f"{type(error).__name__}: {' '.join(str(error).split()).rstrip('.')}") from error
    if not len(triangles):
        raise _no_mesh(file, "it has no triangles")
    return corners, triangles


def _no_mesh(file: Path, why: str) -> ConfigError:
    return ConfigError(
        f"Cannot read the mesh {file}: {why}.", "Save its triangles anew, in metres, as OBJ, binary STL or PLY."
    )


@cache
def _convex_parts(file: Path, _changed_ns: int) -> tuple[Faces, ...]:
    """Return the convex parts that ``coacd`` makes of the mesh, the same ones each time."""
    coacd = import_module("coacd")
    coacd.set_log_level("error")
    made = coacd.run_coacd(coacd.Mesh(*read_mesh(file)), **_DECOMPOSED)
    return tuple((np.asarray(corners, np.float64), np.asarray(triangles, np.int32)) for corners, triangles in made)
