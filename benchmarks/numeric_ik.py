"""A numeric inverse kinematics (damped least squares, restarts) to compare the closed form with."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from bus.arrays import Joints, Transform
from config.limits import LOWER_RAD, UPPER_RAD
from planning.robot import Robot

Array = npt.NDArray[np.float64]

_STEPS = 200
_DAMPING = 1e-6
_CLOSE = 1e-6


def reachable_poses(count: int, seed: int) -> list[Transform]:
    """Random tcp poses over the table, half from above, half tilted by up to 45 degrees."""
    rng = np.random.default_rng([seed, 2])
    poses = []
    for index in range(count):
        pose = np.eye(4)
        yaw, tilt = rng.uniform(-np.pi, np.pi), (index % 2) * np.radians(rng.uniform(0, 45))
        turn = pin.rpy.rpyToMatrix(0.0, 0.0, yaw) @ np.diag([1.0, -1.0, -1.0])
        pose[:3, :3] = turn @ pin.rpy.rpyToMatrix(tilt, 0.0, 0.0)
        pose[:3, 3] = rng.uniform([0.25, -0.3, 0.02], [0.85, 0.3, 0.20])
        poses.append(pose)
    return poses


def numeric_inverse(robot: Robot, base_from_tcp: Transform, restarts: int, seed: int) -> Joints | None:
    """A configuration inside the limits, or None when no restart converged to one."""
    rng = np.random.default_rng(seed)
    target = pin.SE3(base_from_tcp)
    for _ in range(restarts):
        q = _descend(robot, target, rng.uniform(LOWER_RAD, UPPER_RAD))
        if q is not None:
            return q
    return None


def _descend(robot: Robot, target: pin.SE3, q: Joints) -> Joints | None:
    for _ in range(_STEPS):
        error = pin.log6(pin.SE3(robot.base_from_tcp(q)).actInv(target)).vector
        if np.linalg.norm(error) < _CLOSE:
            return q
        world = pin.SE3(robot.base_from_tcp(q)).rotation
        error = np.concatenate([world @ error[:3], world @ error[3:]])
        jacobian = robot.jacobian(q)
        step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + _DAMPING * np.eye(6), error)
        q = np.clip(q + np.clip(step, -0.3, 0.3), LOWER_RAD, UPPER_RAD)
    return None
