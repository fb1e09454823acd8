"""Scenes seen from three sides: a heap, a tall cylinder, a bowl, a box. Frame: ``base``, the table at z = 0."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import cv2
import mujoco
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from benchmarks.heaps.drop import Dropped, compose, drop
from benchmarks.heaps.plan import Plan, plan, station_of
from benchmarks.heaps.shapes import Shape, box, read_shapes
from bus.transforms import apply, from_rotation
from config.schema import Station
from drivers.sim.optics import COLOR_FROM_DEPTH, DEPTH_PINHOLE
from drivers.sim.render import Painter
from drivers.sim.sensor import sense

KINDS = ("heap", "cylinder", "bowl", "box")
"""Kinds of scenes, in turn over the seeds."""
_HEAP = 8
_DIRECTIONS_DEG = ((0.0, 180.0, 0.0), (45.0, 120.0, -150.0), (45.0, 240.0, 150.0))
"""Tilt and azimuth of the direction from the region's middle to each camera, and its roll; azimuth 0 = away from the
robot, roll 0 = the picture's rows are level and its upper edge is the farther one. Of all rolls, these take the FR3
least time from the capture pose; level pictures would hide a mounting that is off along the rows."""
_DISTANCE_M = (0.65, 0.70)
_DEPTH_NOISE = 1.0

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Seen:
    """One scene and what the depth camera measured of it.

    Attributes:
        depths_m: (h, w) of each view [m], NaN = none. ``true_base_from_color``: (4, 4) of each view.
        parts: corners (k, 3) [m] of the convex parts that lie on the table.
        station: that of the scene.
    """

    kind: str
    seed: int
    depths_m: tuple[npt.NDArray[np.float32], ...]
    true_base_from_color: tuple[Array, ...]
    parts: tuple[Array, ...]
    station: Station


def see(seed: int, objects: Path) -> Seen:
    """Make a scene and look at it from above and from two sides. Raises: DriverError, DriverUnavailable."""
    kind = KINDS[seed % len(KINDS)]
    drawn = replace(plan(_HEAP if kind == "heap" else 1, seed), kind="table", base_from_table=np.eye(4))
    station, rng = station_of("table"), drawn.rng(7)
    lying = drop(drawn, read_shapes(objects)) if kind == "heap" else _placed(drawn, station, _SHAPES[kind])
    poses = tuple(_pose(station, *direction, rng.uniform(*_DISTANCE_M)) for direction in _DIRECTIONS_DEG)
    depths_m = _photographed(lying, poses, seed, rng)
    parts = tuple(
        apply(pose, corners)
        for shape, pose in zip(lying.bodies, lying.table_from_body, strict=True)
        for corners in shape.parts
    )
    return Seen(kind, seed, depths_m, poses, parts, station)


def _placed(drawn: Plan, station: Station, shape: Shape) -> Dropped:
    """One shape upright near the region's middle, at a heading of the seed."""
    rng = drawn.rng(8)
    model = compose(drawn, station, [(shape,)], rng).compile()
    data = mujoco.MjData(model)
    x, y = middle_of(station)[:2] + rng.uniform(-0.06, 0.06, 2)
    turn = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi))
    data.joint("loose-0").qpos[:] = [x, y, 0.0, *turn.as_quat(scalar_first=True)]
    mujoco.mj_forward(model, data)
    return Dropped(model, data, (shape,), (from_rotation(turn.as_matrix(), (x, y, 0.0)),))


def _photographed(
    lying: Dropped, poses: tuple[Array, ...], seed: int, rng: np.random.Generator
) -> tuple[npt.NDArray[np.float32], ...]:
    """Depth (h, w) [m] from each pose (4, 4) of the colour camera; the systematic error is one unit's in all."""
    camera, depths_m = lying.model.camera("depth"), []
    painter = Painter(lying.model)
    try:
        for pose in poses:
            base_from_depth = pose @ COLOR_FROM_DEPTH
            rotation = base_from_depth[:3, :3] @ np.diag([1.0, -1.0, -1.0])  # MuJoCo's look along -z with y up
            camera.pos[:] = base_from_depth[:3, 3]
            camera.quat[:] = Rotation.from_matrix(rotation).as_quat(scalar_first=True)
            mujoco.mj_forward(lying.model, lying.data)
            painter.look(lying.data, "depth")
            wide_m = painter.depth_m(DEPTH_PINHOLE.width, DEPTH_PINHOLE.height)
            depth_m = cv2.remap(wide_m, DEPTH_PINHOLE.source_x, DEPTH_PINHOLE.source_y, cv2.INTER_NEAREST)
            depths_m.append(sense(np.asarray(depth_m), rng, seed, _DEPTH_NOISE))
    finally:
        painter.close()
    return tuple(depths_m)


def _pose(station: Station, tilt_deg: float, azimuth_deg: float, roll_deg: float, distance_m: float) -> Array:
    """The colour camera's pose that looks at the region's middle from this direction."""
    tilt, azimuth, roll = np.deg2rad([tilt_deg, azimuth_deg, roll_deg])
    away = np.array([np.cos(azimuth), np.sin(azimuth)])
    at = middle_of(station) + distance_m * np.array([*np.sin(tilt) * away, np.cos(tilt)])
    z = np.array([*-np.sin(tilt) * away, -np.cos(tilt)])
    x = np.array([-away[1], away[0], 0.0])
    level = from_rotation(np.column_stack([x, np.cross(z, x), z]), at)
    return np.asarray(level @ from_rotation(Rotation.from_euler("z", roll).as_matrix()))


def middle_of(station: Station) -> Array:
    """The middle (3,) [m] of the pick region, on the table."""
    x_min, x_max, y_min, y_max = station.scene.pick_region_m
    return np.array([(x_min + x_max) / 2, (y_min + y_max) / 2, 0.0])


def _ring(radius_m: float, low_m: float, high_m: float, flare: float, wall_m: float, around: int = 32) -> list[Array]:
    """Convex segments of a ring about the z axis whose radius grows by ``flare`` [m/m] with the height."""
    out, turns = [], np.linspace(0, 2 * np.pi, around + 1)
    for first, last in pairwise(turns):
        radii = [(z, radius_m + flare * (z - low_m) - off) for z in (low_m, high_m) for off in (0.0, wall_m)]
        out.append(np.array([(r * np.cos(a), r * np.sin(a), z) for z, r in radii for a in (first, last)]))
    return out


def _disc(radius_m: float, low_m: float, high_m: float, around: int = 48) -> Array:
    turns = np.linspace(0, 2 * np.pi, around, endpoint=False)
    return np.array([(radius_m * np.cos(a), radius_m * np.sin(a), z) for z in (low_m, high_m) for a in turns])


_SHAPES = {
    "cylinder": Shape("cylinder", (_disc(0.035, 0.0, 0.200),)),
    "bowl": Shape(
        "bowl",
        (
            _disc(0.035, 0.0, 0.004),
            *_ring(0.035, 0.0, 0.025, 1.2, 0.004),
            *_ring(0.065, 0.025, 0.060, 0.35, 0.004),
        ),
    ),
    "box": box("box", (0.090, 0.060, 0.050), (0.0, 0.0, 0.025)),
}
