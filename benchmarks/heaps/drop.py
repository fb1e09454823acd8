"""Drops bodies onto the table, or into the bin, and lets them come to rest. World = ``table`` (see `plan`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from benchmarks.heaps.plan import HEAPS, Plan, station_of
from benchmarks.heaps.shapes import Shape, box
from benchmarks.heaps.things import thing
from bus.errors import DriverError
from bus.transforms import from_rotation, inverse
from config.scene import scene_boxes
from config.schema import Station
from drivers.sim.mjcf import FRICTION
from drivers.sim.optics import COLOR_FROM_DEPTH, FOVY_DEG

_TIMESTEP_S = 0.002
_SETTLE_S, _SETTLE_S_EACH = 1.6, 0.08
_STILL_S, _STILL_TIMES = 0.1, 4
_FASTEST_M_S = 1.2
"""Falling bodies are kept to this speed: from two metres up they would scatter the heap."""
_FIRST_M, _APART_M = 0.12, 0.10
_AREA_M = {1: (0.080, 0.120), 20: (0.085, 0.120)}
_USUAL_AREA_M = (0.060, 0.090)
_DRAWS = 8
_TABLE_RGBA, _FURNITURE_RGBA = (0.46, 0.50, 0.52, 1.0), (0.20, 0.33, 0.42, 1.0)
_LEAN_DEG, _ABOVE_M = 1.0, 0.001
"""Of a single thing when it is let go on the table."""
_PAIR_SIDE_M, _PAIR_LENGTH_M, _PAIR_HEIGHT_M, _PAIR_GAP_M = (0.022, 0.06), (0.04, 0.11), (0.02, 0.06), (0.0, 0.001)

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Dropped:
    """Bodies at rest.

    Attributes:
        model, data: of the world at rest, with the cameras ``color`` and ``depth``.
        bodies: what lies there. ``table_from_body``: (4, 4) of each.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    bodies: tuple[Shape, ...]
    table_from_body: tuple[Array, ...]


def drop(plan: Plan, shapes: Sequence[Shape]) -> Dropped:
    """Drop ``plan.n`` bodies; drawn again where too few come to rest in the pick region. Raises: DriverError."""
    station, rng = station_of(plan.kind), plan.rng(2)
    for _ in range(_DRAWS):
        loose = _drawn(plan, shapes, rng)
        model = compose(plan, station, loose, rng).compile()
        data = mujoco.MjData(model)
        _throw(model, data, loose, plan, rng)
        _settle(model, data, plan.n)
        dropped = Dropped(model, data, *_apart(model, data, loose))
        if _enough_inside(dropped, station, plan.n):
            return dropped
    raise DriverError(f"The heap n = {plan.n}, seed {plan.seed} does not come to rest.", "Are the objects too large?")


def _drawn(plan: Plan, shapes: Sequence[Shape], rng: np.random.Generator) -> list[tuple[Shape, ...]]:
    """Return the bodies that move as one: a pair of flush boxes, then single ones, no two the same where possible."""
    if plan.set_name != HEAPS:
        return [(thing(plan),)]
    pair = [_pair(rng)] if plan.pair else []
    count = plan.n - 2 * len(pair)
    chosen = rng.choice(len(shapes), count, replace=count > len(shapes))
    return [*pair, *((shapes[int(index)],) for index in chosen)]


def _pair(rng: np.random.Generator) -> tuple[Shape, ...]:
    """Two equal boxes side by side, joined while things fall on them, so that they stay flush."""
    side, length, height = (float(rng.uniform(*range_m)) for range_m in (_PAIR_SIDE_M, _PAIR_LENGTH_M, _PAIR_HEIGHT_M))
    off_m = (side + float(rng.uniform(*_PAIR_GAP_M))) / 2
    return tuple(box("box", (side, length, height), (sign * off_m, 0.0, 0.0)) for sign in (-1, 1))


def compose(
    plan: Plan, station: Station, loose: Sequence[tuple[Shape, ...]], rng: np.random.Generator
) -> mujoco.MjSpec:
    """Compose the world: the station's boxes, lights, both cameras, and a free body for every entry of ``loose``."""
    spec = mujoco.MjSpec()
    spec.option.timestep = _TIMESTEP_S
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.stat.extent = 1.0
    spec.visual.map.znear, spec.visual.map.zfar = 0.02, 8.0
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 2048, 2048
    spec.visual.quality.offsamples, spec.visual.quality.shadowsize = 0, 1024
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = (0.35,) * 3, (0.25,) * 3
    spec.visual.headlight.specular = (0.0,) * 3
    furnish(spec, station)
    for side in (-1.0, 1.0):
        light = spec.worldbody.add_light(pos=(0.4, 1.2 * side, 1.8), dir=(0, -0.55 * side, -1))
        light.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
        light.diffuse, light.specular, light.castshadow = (0.38,) * 3, (0.08,) * 3, False
    table_from_color = inverse(plan.base_from_table) @ plan.true_base_from_color
    for name, pose in (("color", table_from_color), ("depth", table_from_color @ COLOR_FROM_DEPTH)):
        _add_camera(spec, name, pose)
    for index, members in enumerate(loose):
        colors = [_rgba(rng)] * len(members) if plan.pair == "same" else [_rgba(rng) for _ in members]
        add_body(spec, f"loose-{index}", members, colors)
    return spec


def furnish(spec: mujoco.MjSpec, station: Station) -> None:
    """Add the station's fixed boxes, where the station says in ``base``, to the world ``table``."""
    for one in scene_boxes(station.scene):
        rgba = _TABLE_RGBA if one.name == station.scene.table.name else _FURNITURE_RGBA
        size = [side / 2 for side in one.size_m]
        spec.worldbody.add_geom(name=one.name, type=mujoco.mjtGeom.mjGEOM_BOX, size=size, pos=one.center_m, rgba=rgba)


def add_body(
    spec: mujoco.MjSpec, name: str, members: Sequence[Shape], colors: Sequence[tuple[float, ...]]
) -> mujoco.MjsBody:
    """Add a free body of the convex parts of all ``members``, each in its colour."""
    body = spec.worldbody.add_body(name=name)
    body.add_freejoint(name=name)
    for member, (shape, rgba) in enumerate(zip(members, colors, strict=True)):
        for number, corners in enumerate(shape.parts):
            mesh = spec.add_mesh(name=f"{name}-{member}-{number}", uservert=corners.ravel())
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name, rgba=rgba, density=shape.density_kg_m3,
                friction=FRICTION, condim=4, group=2,
            )  # fmt: skip
    return body


def aim(dropped: Dropped, table_from_color: Array) -> None:
    """Move both cameras, so that the colour camera is at (4, 4) ``table_from_color``; nothing else moves."""
    for name, pose in (("color", table_from_color), ("depth", table_from_color @ COLOR_FROM_DEPTH)):
        camera = dropped.model.camera(name)
        camera.pos[:], camera.quat[:] = pose[:3, 3], _quaternion(pose)
    mujoco.mj_camlight(dropped.model, dropped.data)


def _add_camera(spec: mujoco.MjSpec, name: str, pose: Array) -> None:
    spec.worldbody.add_camera(name=name, pos=pose[:3, 3], quat=_quaternion(pose), fovy=FOVY_DEG[name])


def _quaternion(pose: Array) -> Array:
    """MuJoCo's (w, x, y, z) of a camera's pose; its cameras look along -z with y up."""
    return np.asarray(Rotation.from_matrix(pose[:3, :3] @ np.diag([1.0, -1.0, -1.0])).as_quat(scalar_first=True))


def _rgba(rng: np.random.Generator) -> tuple[float, ...]:
    """A random colour, neither black nor white."""
    value, paleness = rng.uniform(0.35, 0.95), rng.uniform(0.1, 0.8)
    return (*(float(value * max(share, paleness)) for share in rng.uniform(0, 1, 3)), 1.0)


# --- falling ----------------------------------------------------------------------------------------------------------


def _throw(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    loose: Sequence[tuple[Shape, ...]],
    plan: Plan,
    rng: np.random.Generator,
) -> None:
    """Put bodies one above the other at random orientations; a pair, or a thing of a set, on the table as it stands."""
    x_min, x_max, y_min, y_max = station_of(plan.kind).scene.pick_region_m
    area_m = np.array(_AREA_M.get(plan.n, _USUAL_AREA_M))
    for index, members in enumerate(loose):
        joint = data.joint(f"loose-{index}")
        joint.qpos[:2] = np.array([x_min + x_max, y_min + y_max]) / 2 + rng.uniform(-area_m, area_m)
        joint.qpos[2] = _FIRST_M + _APART_M * index
        joint.qpos[3:] = Rotation.random(random_state=rng).as_quat(scalar_first=True)
        if len(members) > 1:
            joint.qpos[2] = -min(part[:, 2].min() for shape in members for part in shape.parts)
            joint.qpos[3:] = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)).as_quat(scalar_first=True)
        if plan.set_name != HEAPS:
            leaning = rng.uniform(-_LEAN_DEG, _LEAN_DEG, 2)
            turn = Rotation.from_euler("zyx", [rng.uniform(-180, 180), *leaning], degrees=True)
            joint.qpos[2] = _ABOVE_M - turn.apply(np.concatenate(members[0].parts))[:, 2].min()
            joint.qpos[3:] = turn.as_quat(scalar_first=True)


def _settle(model: mujoco.MjModel, data: mujoco.MjData, n: int) -> None:
    for _ in range(round((_SETTLE_S + _SETTLE_S_EACH * n) / _TIMESTEP_S)):
        mujoco.mj_step(model, data)
        speed_m_s = np.linalg.norm(data.qvel.reshape(-1, 6)[:, :3], axis=1)
        if speed_m_s.max() > _FASTEST_M_S:
            data.qvel.reshape(-1, 6)[:, :3] *= np.minimum(1, _FASTEST_M_S / np.maximum(speed_m_s, 1e-9))[:, None]
    for _ in range(_STILL_TIMES):
        data.qvel[:] = 0.0
        for _ in range(round(_STILL_S / _TIMESTEP_S)):
            mujoco.mj_step(model, data)
    data.qvel[:] = 0.0
    mujoco.mj_forward(model, data)


def _apart(
    model: mujoco.MjModel, data: mujoco.MjData, loose: Sequence[tuple[Shape, ...]]
) -> tuple[tuple[Shape, ...], tuple[Array, ...]]:
    """Return every single body with its pose in ``table``."""
    bodies: list[Shape] = []
    poses: list[Array] = []
    for index, members in enumerate(loose):
        truth = data.body(f"loose-{index}")
        pose = from_rotation(truth.xmat.reshape(3, 3), truth.xpos)
        bodies += members
        poses += [pose] * len(members)
    return tuple(bodies), tuple(poses)


def _enough_inside(dropped: Dropped, station: Station, n: int) -> bool:
    """Whether the middles of most bodies, of up to three of all, lie on the table in the pick region."""
    x_min, x_max, y_min, y_max = station.scene.pick_region_m
    inside = 0
    for shape, pose in zip(dropped.bodies, dropped.table_from_body, strict=True):
        x, y, z = pose[:3, :3] @ np.concatenate(shape.parts).mean(axis=0) + pose[:3, 3]
        inside += x_min < x < x_max and y_min < y < y_max and z > 0
    return inside >= (n if n <= 3 else math.ceil(n / 2))
