"""Seeded pick problems: a table, a bin with walls, five boxes, an object in the bin; either known, or only observed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bus.messages import Grasp
from config.devices import NodeSettings
from config.limits import FR3
from config.scene import Box, SceneSettings, Table
from config.schema import Station
from planning.arm import limit_distance_rad
from planning.candidates import Approach, approaches, grasp_pose, twins
from planning.height_field import Sight
from planning.kinematics import FR3_ARM, inverse, q7_grid
from planning.line import tcp_line
from planning.robot import Robot, flange_pose
from planning.scene import Scene
from planning.search import LIMIT_MARGIN_RAD

Array = npt.NDArray[np.float64]

TABLE = Table(name="table", center_m=(0.45, 0.0, -0.02), size_m=(1.5, 2.0, 0.04))
PLACE_M = (0.40, 0.45, 0.20)
_BIN_M = (0.46, 0.0, 0.36, 0.46)  # centre x, y and inner size
_WALL_M, _WALL_HEIGHT_M = 0.010, 0.08
_KEEP_FREE_M = ((0.0, 0.0, 0.22), (PLACE_M[0], PLACE_M[1], 0.16))  # base and tray: x, y, radius
_PICKS_A_SCENE = 4
_CAMERA_M = np.array([0.45, 0.0, 1.5])
_PIXEL_M = 0.004  # on the table
_NOISE_M = 0.001
_FEASIBLE_TRIES = 200


@dataclass(frozen=True)
class Problem:
    """One pick.

    Attributes:
        boxes: what really stands there, the table first. ``seen_only``: the planner knows the table only, and sees the
            rest.
        scene: what the planner is given. ``target``: the object's true box, turned by ``yaw_rad`` about the vertical.
    """

    number: int
    boxes: tuple[Box, ...]
    seen_only: bool
    sight: Sight | None
    target_points: Array
    approach: Approach
    target: Box
    yaw_rad: float

    def scene(self, robot: Robot) -> Scene:
        """Return the scene that the planner is given."""
        if self.sight is not None:
            return Scene.of(robot, robot.station, *([self.sight] if self.sight else []), boxes=(TABLE,))
        return Scene(robot, robot.station, self.boxes, target=self.target_points)


def station() -> Station:
    """The default cell without a tray, which the boxes stand for."""
    nodes = {"sim": NodeSettings(driver="sim", serves=("camera", "arm", "hand"))}
    return Station(nodes=nodes, scene=SceneSettings(table=TABLE, place_m=PLACE_M))


def problems(robot: Robot, scenes: int, seed: int) -> Iterator[Problem]:
    """`_PICKS_A_SCENE` feasible picks in each of so many scenes; every second scene is only seen."""
    number = 0
    for index in range(scenes):
        rng = np.random.default_rng([seed, index])
        boxes = _boxes(robot, rng)
        for _ in range(_PICKS_A_SCENE):
            yield _problem(robot, boxes, index % 2 == 1, number, rng)
            number += 1


def _boxes(robot: Robot, rng: np.random.Generator) -> tuple[Box, ...]:
    capture_q = np.array(robot.station.arm.capture_q_rad)
    while True:
        boxes = (TABLE, *_bin(), *(_box(f"box-{i}", rng) for i in range(5)))
        if Scene(robot, robot.station, boxes).collision(capture_q, robot.station.hand.max_width_m) is None:
            return boxes


def _bin() -> tuple[Box, ...]:
    x, y, length, width = _BIN_M
    z, height = _WALL_HEIGHT_M / 2, _WALL_HEIGHT_M
    along_x, along_y = (length + 2 * _WALL_M, _WALL_M, height), (_WALL_M, width, height)
    off_x, off_y = (length + _WALL_M) / 2, (width + _WALL_M) / 2
    return (
        Box(name="bin-front", center_m=(x - off_x, y, z), size_m=along_y),
        Box(name="bin-back", center_m=(x + off_x, y, z), size_m=along_y),
        Box(name="bin-right", center_m=(x, y - off_y, z), size_m=along_x),
        Box(name="bin-left", center_m=(x, y + off_y, z), size_m=along_x),
    )


def _box(name: str, rng: np.random.Generator) -> Box:
    """10 to 50 cm tall, beside the bin, the base and the place."""
    while True:
        size = np.array([*rng.uniform(0.05, 0.15, 2), rng.uniform(0.10, 0.50)])
        x, y = rng.uniform(0.15, 0.80), rng.uniform(-0.50, 0.70)
        half = size[:2] / 2
        beside_bin = abs(x - _BIN_M[0]) > _BIN_M[2] / 2 + half[0] + 0.02 or abs(y) > _BIN_M[3] / 2 + half[1] + 0.02
        free = all(np.hypot(x - cx, y - cy) > r + np.hypot(*half) for cx, cy, r in _KEEP_FREE_M)
        if beside_bin and free:
            return Box(name=name, center_m=(x, y, size[2] / 2), size_m=(size[0], size[1], size[2]))


def _problem(robot: Robot, boxes: tuple[Box, ...], seen_only: bool, number: int, rng: np.random.Generator) -> Problem:
    for _ in range(_FEASIBLE_TRIES):
        target, yaw_rad, grasp = _target(rng)
        points = _surface(target, yaw_rad)
        scene = Scene(robot, robot.station, boxes, target=points)
        for approach in approaches([grasp], robot.station):
            if _feasible(scene, approach):
                sight = _sight(boxes, target, yaw_rad, rng) if seen_only else None
                return Problem(number, boxes, seen_only, sight, points, approach, target, yaw_rad)
    raise RuntimeError(f"scene of problem {number}: no feasible pick in {_FEASIBLE_TRIES} tries")


def _target(rng: np.random.Generator) -> tuple[Box, float, Grasp]:
    """An upright box in the bin, grasped across its narrow side near its top."""
    x, y, length, width = _BIN_M
    size = np.array([rng.uniform(0.04, 0.10), rng.uniform(0.02, 0.05), rng.uniform(0.03, 0.12)])
    reach = np.hypot(size[0], size[1]) / 2
    cx = x + rng.uniform(-1, 1) * (length / 2 - reach)
    cy = y + rng.uniform(-1, 1) * (width / 2 - reach)
    yaw = rng.uniform(-np.pi, np.pi)
    pose = np.eye(4)
    pose[:3, :3] = _turn(yaw) @ np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = cx, cy, max(0.015, size[2] - 0.03)
    grasp = Grasp(base_from_tcp=pose, width_m=size[1], opening_m=size[1] + 0.012, score=1.0, rectangle=0,
                  imagined_base_from_tcp=pose, terms={})  # fmt: skip
    return Box(name="target", center_m=(cx, cy, size[2] / 2), size_m=(size[0], size[1], size[2])), yaw, grasp


def _feasible(scene: Scene, approach: Approach) -> bool:
    """Whether any arm configuration off the limits can approach and lift."""
    plan, station = scene.station.planning, scene.station
    pose, grasp, empty = grasp_pose(approach, station), approach.grasp, scene.empty()
    back_m, up_m = -plan.approach_m * pose[:3, 2], np.array([0.0, 0.0, plan.lift_m])
    for twin in twins(pose):
        for q in inverse(flange_pose(twin), q7_grid()):
            if limit_distance_rad(FR3, q) < LIMIT_MARGIN_RAD or scene.collision(q, grasp.opening_m) is not None:
                continue
            away, lift = tcp_line(FR3_ARM, q, twin, back_m), tcp_line(FR3_ARM, q, twin, up_m)
            if away is None or lift is None or scene.first_collision(away, grasp.opening_m) is not None:
                continue
            if empty.first_collision(lift, grasp.width_m) is None:
                return True
    return False


# --- what a camera above would see ------------------------------------------------------------------------------------


def _sight(boxes: tuple[Box, ...], target: Box, yaw_rad: float, rng: np.random.Generator) -> Sight:
    """A noisy depth image from above: each ray's first hit."""
    x = np.arange(TABLE.center_m[0] - 0.45, TABLE.center_m[0] + 0.45, _PIXEL_M)
    y = np.arange(-0.75, 0.85, _PIXEL_M)
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    rays = np.concatenate([grid, np.zeros((*grid.shape[:2], 1))], axis=-1) - _CAMERA_M
    hits = [_entry(rays, _CAMERA_M, box) for box in boxes]
    to_target = _turn(-yaw_rad)
    origin = to_target @ (_CAMERA_M - target.center_m) + target.center_m
    hits.append(_entry(rays @ to_target.T, origin, target))
    share = np.stack(hits)
    nearest = share.min(axis=0)
    nearest = nearest + rng.normal(0.0, _NOISE_M, nearest.shape) / np.linalg.norm(rays, axis=-1)
    points = (_CAMERA_M + nearest[..., None] * rays).astype(np.float32)
    return Sight(points, np.argmin(share, axis=0) == len(boxes))


def _entry(rays: Array, origin: Array, box: Box) -> Array:
    """Return where rays (h, w, 3) from ``origin`` enter the box, as a share of their length; infinite if they miss."""
    low = np.array(box.center_m) - np.array(box.size_m) / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (low - origin) / rays, (low + box.size_m - origin) / rays
    enter, leave = np.minimum(one, other).max(axis=-1), np.maximum(one, other).min(axis=-1)
    return np.asarray(np.where(enter <= leave, enter, np.inf))


def _surface(target: Box, yaw_rad: float) -> Array:
    """The corners of the target's top."""
    half = np.array(target.size_m) / 2
    share = np.linspace(-1, 1, 9)
    top = np.array([[a * half[0], b * half[1], half[2]] for a in share for b in share])
    return np.asarray(top @ _turn(yaw_rad).T + target.center_m)


def _turn(yaw_rad: float) -> Array:
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
