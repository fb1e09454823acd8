"""Things at rest on a level table, and RGB-D images of them by a pinhole camera that leans. ``base`` is the table's.

Nothing is off: the table is z = 0, and the camera is where it is said to be. Only the depth has a sensor's errors.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt

from benchmarks.heaps.drop import Dropped, aim, drop
from benchmarks.heaps.heap import Heap, loose_parts
from benchmarks.heaps.plan import Plan, plan
from benchmarks.heaps.shapes import Shape, box, read_shapes
from benchmarks.held.solids import things
from bus.transforms import from_rotation
from drivers.sim.objects import add_object, object_names
from drivers.sim.render import Painter
from drivers.sim.sensor import sense

PAPER, OBJECTS, BOXES, FIVE = "paper", "object_sim", "boxes", "five"
SETS = (PAPER, OBJECTS, BOXES, FIVE)
"""What lies there: one of the paper's objects, of object_sim's, or a box; or five of object_sim's together."""
TILTS_DEG = (0.0, 15.0, 20.0, 30.0, 40.0, 45.0)
"""Angles of the optical axis from straight down."""
_BOXES_M = tuple((side, depth, 0.08) for side in (0.03, 0.045, 0.06) for depth in (0.04, 0.06, 0.08))
_WIDTH, _HEIGHT, _FOCAL_PX = 640, 480, 600.0
_AWAY_M, _ASIDE_M = (0.55, 0.75), 0.03
_COLOR_NOISE, _DEPTH_NOISE = 1.5, 1.0
_AZIMUTH, _PICTURE = 7, 20
"""Purposes of the random numbers of a scene (`Plan.rng`)."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Picture:
    """What `vlad_cell.detect` is given: ``color`` (H, W, 3) RGB, ``depth_m`` (H, W), ``K`` (3, 3), and the pose."""

    tilt_deg: float
    color: npt.NDArray[np.uint8]
    depth_m: npt.NDArray[np.float32]
    K: Array
    base_from_camera: Array


@dataclass(frozen=True)
class Scene:
    """What lies there, as the judge and the oracle take it, and its pictures, one of every tilt."""

    truth: Heap
    pictures: tuple[Picture, ...]


def scene(set_name: str, seed: int, objects: Path, tilts_deg: Sequence[float] = TILTS_DEG) -> Scene:
    """Drop what belongs to a seed, and take its pictures. Raises: DriverError, DriverUnavailable."""
    level = replace(plan(5 if set_name == FIVE else 1, seed), kind="table", pair="", base_from_table=np.eye(4))
    dropped = drop(level, _shapes(set_name, objects))
    parts = tuple(loose_parts(dropped, level.base_from_table))
    nothing, pose = np.zeros((0, 0)), level.base_from_color
    truth = Heap(
        level.n, seed, level.kind, "", tuple(shape.name for shape in dropped.bodies), nothing.astype(np.uint8),
        nothing.astype(np.float32), pose, pose, level.base_from_table, parts,
    )  # fmt: skip
    return Scene(truth, tuple(_pictures(dropped, truth, level, tilts_deg)))


@cache
def _shapes(set_name: str, objects: Path) -> tuple[Shape, ...]:
    if set_name in (OBJECTS, FIVE):
        return read_shapes(objects)
    if set_name == BOXES:
        return tuple(box("box", size_m) for size_m in _BOXES_M)
    return tuple(_of_paper(name) for name in object_names(None))


def _of_paper(name: str) -> Shape:
    spec = mujoco.MjSpec()
    add_object(spec, name, None, "object")
    (one,) = things(spec.compile(), {"object": name})
    return Shape(name, one.parts)


def _pictures(dropped: Dropped, truth: Heap, level: Plan, tilts_deg: Sequence[float]) -> Iterator[Picture]:
    """Every picture of a scene is taken from one side, which its seed gives."""
    rng = level.rng(_AZIMUTH)
    azimuth_rad, away_m, aside_m = rng.uniform(-np.pi, np.pi), rng.uniform(*_AWAY_M), rng.uniform(-1, 1, 2) * _ASIDE_M
    corners = np.concatenate([part.corners for part in truth.parts])
    at = (corners.min(axis=0) + corners.max(axis=0)) / 2 + np.append(aside_m, 0.0)
    camera = dropped.model.camera("color")
    camera.fovy[:] = np.degrees(2 * np.arctan(_HEIGHT / 2 / _FOCAL_PX))
    K = np.array([[_FOCAL_PX, 0, (_WIDTH - 1) / 2], [0, _FOCAL_PX, (_HEIGHT - 1) / 2], [0, 0, 1]])
    painter = Painter(dropped.model)
    try:
        for tilt_deg in tilts_deg:
            pose = looking(at, np.radians(tilt_deg), azimuth_rad, away_m)
            aim(dropped, pose)
            mujoco.mj_forward(dropped.model, dropped.data)
            painter.look(dropped.data, "color")
            noise = level.rng(_PICTURE + round(tilt_deg))
            pixels = painter.color(_WIDTH, _HEIGHT)
            color = (pixels + noise.normal(0.0, _COLOR_NOISE, pixels.shape)).clip(0, 255).astype(np.uint8)
            depth_m = sense(painter.depth_m(_WIDTH, _HEIGHT), noise, level.seed, _DEPTH_NOISE)
            yield Picture(tilt_deg, color, depth_m, K, pose)
    finally:
        painter.close()


def looking(at: Array, tilt_rad: float, azimuth_rad: float, away_m: float) -> Array:
    """Return base_from_camera (4, 4) of one that looks at a point (3,) from so far away; x of the picture is level."""
    out = np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.0])
    z = -np.sin(tilt_rad) * out - np.cos(tilt_rad) * np.array([0.0, 0.0, 1.0])
    x = np.array([-np.sin(azimuth_rad), np.cos(azimuth_rad), 0.0])
    return from_rotation(np.column_stack([x, np.cross(z, x), z]), at - away_m * z)
