"""Straight lines of the tcp, in joint space. Frames: docs/frames.md."""

from __future__ import annotations

import numpy as np

from bus.arrays import Joints, JointSamples, Transform, Vector3
from config.limits import LOWER_RAD, UPPER_RAD
from planning.kinematics import branches
from planning.robot import flange_pose

_LINE_STEP_M = 0.010
_MAX_LINE_STEP_RAD = 0.25


def tcp_line(q_from_rad: Joints, base_from_tcp: Transform, shift_m: Vector3) -> JointSamples | None:
    """Return the joint path (n, 7) that moves the tcp straight by ``shift_m`` (3,) in ``base`` without turning it.

    q7 stays, and each step takes the nearest branch.

    Args:
        q_from_rad: (7,) start; its tcp is at ``base_from_tcp`` (4, 4).

    Returns:
        None when the line leaves the reach or the limits, or when the branch flips (a step above 0.25 rad).
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
