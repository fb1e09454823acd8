"""Shows the camera what the fingers touch: convex contact parts that reach beyond an object's visual mesh are drawn.

They bridge hollows: a mug's wall may be 7 mm thicker to the touch than to the eye. No camera meets such a thing.
"""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull

from drivers.sim.meshes import CONTACT_GROUP

_SEEN_GROUP = 2
_BEYOND_M = 0.002
"""A part that reaches so far beyond what is drawn is drawn, too: as far as the depth's own noise."""
_SAMPLES = 4000
_OPAQUE = 0.5
"""MuJoCo leaves translucent geoms out of its depth; what is more opaque than this a depth camera measures."""

Array = npt.NDArray[np.float64]


def show_what_is_touched(model: mujoco.MjModel, body: str) -> None:
    """Draw those convex meshes among an object's contact parts that cover its visual mesh, in its colour.

    Args:
        model: compiled; its drawing is changed, what collides in it is not. ``body``: the object's.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    own = np.flatnonzero(model.body_rootid[model.geom_bodyid] == model.body(body).id)
    _make_opaque(model, own)
    meshes = own[model.geom_type[own] == mujoco.mjtGeom.mjGEOM_MESH]
    is_touched = model.geom_group[meshes] == CONTACT_GROUP
    drawn = meshes[~is_touched]
    if not len(drawn):
        return
    surface = np.concatenate([_on_surface(model, data, geom) for geom in drawn])
    for geom in meshes[is_touched]:
        if _covers(_corners(model, data, geom), surface):
            model.geom_group[geom], model.geom_matid[geom] = _SEEN_GROUP, -1
            model.geom_rgba[geom] = _color(model, drawn[0])


def _make_opaque(model: mujoco.MjModel, geoms: npt.NDArray[np.intp]) -> None:
    for rgba in _colors(model, geoms):
        if rgba[3] > _OPAQUE:
            rgba[3] = 1.0


def _colors(model: mujoco.MjModel, geoms: npt.NDArray[np.intp]) -> Iterator[npt.NDArray[np.float32]]:
    """Yield views of the colours (4,) of geoms and of their materials."""
    for geom in geoms:
        yield model.geom_rgba[geom]
        if model.geom_matid[geom] >= 0:
            yield model.mat_rgba[model.geom_matid[geom]]


def _color(model: mujoco.MjModel, geom: np.intp) -> npt.NDArray[np.float32]:
    material = model.geom_matid[geom]
    return np.array(model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom])


def _corners(model: mujoco.MjModel, data: mujoco.MjData, geom: np.intp) -> Array:
    """Corners (n, 3) of a mesh geom in the world."""
    mesh = model.geom_dataid[geom]
    corners = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]].astype(float)
    return np.asarray(corners @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom])


def _on_surface(model: mujoco.MjModel, data: mujoco.MjData, geom: np.intp) -> Array:
    """Points (n, 3) spread evenly over a mesh geom, the same ones each time."""
    mesh, corners, rng = model.geom_dataid[geom], _corners(model, data, geom), np.random.default_rng(0)
    faces = model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]
    a, b, c = (corners[faces[:, index]] for index in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    at, share = rng.choice(len(faces), _SAMPLES, p=area / area.sum()), rng.random((_SAMPLES, 2, 1))
    share = np.where(share.sum(axis=1, keepdims=True) > 1, 1 - share, share)
    return np.asarray(a[at] + share[:, 0] * (b - a)[at] + share[:, 1] * (c - a)[at])


def _covers(corners: Array, surface: Array) -> bool:
    """Whether some point of the surface (n, 3) lies deep inside the hull of the corners."""
    planes = ConvexHull(corners).equations
    return bool((surface @ planes[:, :3].T + planes[:, 3] < -_BEYOND_M).all(axis=1).any())
