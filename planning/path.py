"""Geometric paths in joint space: straight joint lines, straight lines of the tcp, and whether they are free."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bus.arrays import Joints, JointSamples, Transform
from config.limits import LOWER_RAD, UPPER_RAD
from planning.kinematics import branches
from planning.robot import HAND_FROM_TCP_M, Robot

Array = npt.NDArray[np.float64]

CHECK_STEP_M = 0.003
"""No point of the robot moves farther than this between two collision checks."""
_LEVER_M = np.array([1.15, 1.15, 0.95, 0.85, 0.45, 0.40, 0.20])
"""Farthest that a point of arm, hand or camera can be from each joint's axis."""
_LINE_STEP_M = 0.005
_MAX_LINE_STEP_RAD = 0.25


def first_collision(robot: Robot, q_rad: JointSamples, *, width_m: float | None = None) -> str | None:
    """What the robot touches first on the polyline ``q_rad`` (n, 7), or None.

    With the robot's clearance c, checks at most `CHECK_STEP_M` apart prove that c - 1.5 mm remain everywhere.
    """
    travel_m = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(q_rad, axis=0)) @ _LEVER_M)])
    checks = int(np.ceil(travel_m[-1] / CHECK_STEP_M)) + 1
    at = np.linspace(0.0, travel_m[-1], checks)
    dense = np.stack([np.interp(at, travel_m, column) for column in q_rad.T], axis=1) if checks > 1 else q_rad[:1]
    for q in dense:
        touch = robot.collision(q, width_m=width_m)
        if touch is not None:
            return touch
    return None


def flange_pose(base_from_tcp: Array) -> Array:
    """Flange poses (..., 4, 4) that bring the tcp to ``base_from_tcp`` (..., 4, 4)."""
    half = np.sqrt(0.5)
    tcp_from_flange = np.array(
        [[half, -half, 0, 0], [half, half, 0, 0], [0, 0, 1, -HAND_FROM_TCP_M], [0, 0, 0, 1]]
    )  # the hand is mounted turned by -45 degrees
    return np.asarray(base_from_tcp @ tcp_from_flange)


def tcp_line(q_from_rad: Joints, base_from_tcp: Transform, shift_m: Array) -> JointSamples | None:
    """Joint path (n, 7) that moves the tcp straight by ``shift_m`` (3,) in ``base`` without turning it.

    q7 stays, and each step takes the nearest branch; None when the line leaves the reach or the limits, or when the
    branch flips (a step above 0.25 rad).

    Args:
        q_from_rad: start; its tcp is at ``base_from_tcp``.
    """
    count = int(np.ceil(np.linalg.norm(shift_m) / _LINE_STEP_M)) + 1
    poses = np.repeat(base_from_tcp[None], max(count, 5), axis=0)
    poses[:, :3, 3] += np.linspace(0.0, 1.0, len(poses))[:, None] * shift_m
    q_rad = [q_from_rad]
    for options in branches(flange_pose(poses), q_from_rad[6])[1:]:
        step = np.abs(options - q_rad[-1]).max(axis=1)
        step[np.isnan(step)] = np.inf
        nearest = int(np.argmin(step))
        if step[nearest] > _MAX_LINE_STEP_RAD:
            return None
        q_rad.append(options[nearest])
    line = np.array(q_rad)
    inside = ((line >= LOWER_RAD) & (line <= UPPER_RAD)).all()
    return line if inside else None
