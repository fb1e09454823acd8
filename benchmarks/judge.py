"""Checks trajectories without the planner's code: exact shapes, true boxes, the least possible time, and stops."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, pairwise
from typing import Any

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin
import toppra
from scipy.interpolate import CubicSpline
from toppra.constraint import DiscretizationType, JointAccelerationConstraint

from benchmarks.picks import Problem
from bus.trajectory import TICK_S, Trajectory
from config.limits import ACCELERATION_RAD_S2, FR3
from drivers.motion.stream import Stream
from planning.robot import Robot
from planning.timing import PositionDependentVelocity

Array = npt.NDArray[np.float64]

EVERY_TICKS = 4
_GRID = 1501
_POINTS = 601
_CHAIN = ("link0", "link1", "link2", "link3", "link4", "link5", "link6", "link7")
_LIFTED_M = 0.06
"""The held object is judged from this height on: before, it touches what it stood on."""


class Judge:
    """Exact meshes of the robot among true shapes; every pair of shapes tested, no broad phase.

    Args:
        obstacles: their shapes, and their poses (4, 4) in ``base``.
        floors: the first so many of them carry the robot's base, which touches them.
    """

    def __init__(self, robot: Robot, obstacles: Sequence[tuple[coal.CollisionGeometry, Array]], floors: int) -> None:
        self._robot, self._obstacles = robot, obstacles
        self._model = pin.GeometryModel()
        for part in robot.meshes:
            self._model.addGeometryObject(part)
        self._parts = [part.name for part in robot.meshes]
        added = [self._add(f"obstacle {number}", *one) for number, one in enumerate(obstacles)]
        for a, b in combinations(range(len(self._parts)), 2):
            if not _mounted_together(self._parts[a], self._parts[b]):
                self._model.addCollisionPair(pin.CollisionPair(a, b))
        for part in range(len(self._parts)):
            for obstacle in added[floors if "link0" in self._parts[part] else 0 :]:
                self._model.addCollisionPair(pin.CollisionPair(part, obstacle))
        self._data, self._geometry = robot.model.createData(), self._model.createData()

    def touches(self, trajectory: Trajectory, width_m: float) -> bool:
        """Whether the robot touches itself or an obstacle anywhere along the commands."""
        for q in trajectory.filtered()[::EVERY_TICKS]:
            full = np.array([*q, width_m / 2, width_m / 2])
            if pin.computeCollisions(self._robot.model, self._data, self._model, self._geometry, full, True):
                return True
        return False

    def held_touches(self, trajectory: Trajectory, base_from_tcp: Array, problem: Problem) -> bool:
        """Whether the true target, held as it was grasped, touches an obstacle anywhere along the commands."""
        target = coal.Box(*problem.target.size_m)
        base_from_target = _pose(problem.target.center_m)
        c, s = np.cos(problem.yaw_rad), np.sin(problem.yaw_rad)
        base_from_target[:2, :2] = [[c, -s], [s, c]]
        tcp_from_target = np.linalg.inv(base_from_tcp) @ base_from_target
        for q in trajectory.filtered()[::EVERY_TICKS]:
            tcp = self._robot.base_from_tcp(q)
            if tcp[2, 3] > base_from_tcp[2, 3] + _LIFTED_M and self._hit(target, tcp @ tcp_from_target):
                return True
        return False

    def _hit(self, shape: coal.Box, base_from_shape: Array) -> bool:
        for obstacle, pose in self._obstacles:
            result = coal.CollisionResult()
            coal.collide(
                shape, _transform(base_from_shape), obstacle, _transform(pose), coal.CollisionRequest(), result
            )
            if result.isCollision():
                return True
        return False

    def _add(self, name: str, shape: coal.CollisionGeometry, pose: Array) -> int:
        return int(self._model.addGeometryObject(pin.GeometryObject(name, 0, 0, pin.SE3(pose), shape)))


def judge_of(robot: Robot, problem: Problem) -> Judge:
    """The judge of one pick, among its true boxes; the table is the first."""
    return Judge(robot, [(coal.Box(*box.size_m), _pose(box.center_m)) for box in problem.boxes], floors=1)


def optimal_s(trajectory: Trajectory) -> float:
    """The least time of the same path at the same limits, its jerk unlimited (toppra, 1501 grid points)."""
    raw = trajectory.raw_q_rad
    ticks = np.arange(len(raw))
    evenly = np.interp(np.linspace(0.0, 1.0, _POINTS), _travel(raw) / _travel(raw)[-1], ticks)
    points = CubicSpline(ticks, raw)(evenly)
    at = _travel(points)
    path = toppra.SplineInterpolator(at, points, bc_type="not-a-knot")
    limit = ACCELERATION_RAD_S2[:, None] * np.array([-1.0, 1.0])
    acceleration = JointAccelerationConstraint(limit, discretization_scheme=DiscretizationType.Interpolation)
    solver: Any = toppra.algorithm.TOPPRA(
        [PositionDependentVelocity(FR3, 1.0), acceleration],
        path,
        gridpoints=np.linspace(0.0, at[-1], _GRID),
        solver_wrapper="seidel",
        parametrizer="ParametrizeConstAccel",
    )
    return float(solver.compute_trajectory(0.0, 0.0).duration)


def _travel(points: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def stopped(trajectory: Trajectory, share: float) -> tuple[float, float, Array]:
    """Time from a stop at ``share`` of the trajectory to rest [s], distance off its path [rad], and the commands."""
    stream = Stream(trajectory, FR3)
    commands: list[Array] = []
    planned = trajectory.filtered()
    tick = int(share * (len(planned) - 1))
    while True:
        if len(commands) == tick:
            stream.brake()
        command = stream.next()
        if command is None:
            break
        commands.append(command)
    braked = np.array(commands)
    moved = np.flatnonzero(np.abs(np.diff(braked, axis=0)).max(axis=1) > 1e-9)
    rest = int(moved[-1]) + 1 if len(moved) else 0
    return max(0.0, (rest - tick) * TICK_S), _off_path(braked[tick::10], planned), braked


def _off_path(points: Array, path: Array) -> float:
    """Largest distance, in the worst joint, of ``points`` (n, 7) from the polyline ``path`` (m, 7)."""
    worst = 0.0
    for point in points:
        nearest = int(np.argmin(np.linalg.norm(path - point, axis=1)))
        around = path[max(0, nearest - 1) : nearest + 2]
        worst = max(worst, min(_off_line(point, a, b) for a, b in pairwise(around)))
    return worst


def _off_line(point: Array, a: Array, b: Array) -> float:
    along = np.clip((point - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-30), 0.0, 1.0)
    return float(np.abs(point - a - along * (b - a)).max())


def _mounted_together(a: str, b: str) -> bool:
    """Neighbours of the chain, and what is mounted on the last link."""
    one, other = (_place(name) for name in (a, b))
    return abs(one - other) <= 1 or {one, other} == {5, 7}


def _place(name: str) -> int:
    for index, link in enumerate(_CHAIN):
        if link in name:
            return index
    return len(_CHAIN) if "link" not in name else len(_CHAIN) - 1


def _pose(center_m: tuple[float, float, float]) -> Array:
    pose = np.eye(4)
    pose[:3, 3] = center_m
    return pose


def _transform(pose: Array) -> coal.Transform3s:
    return coal.Transform3s(np.ascontiguousarray(pose[:3, :3]), np.ascontiguousarray(pose[:3, 3]))
