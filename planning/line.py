"""Straight lines of the tcp, in joint space. Frames: docs/frames.md."""

from __future__ import annotations

import numpy as np

from bus.arrays import Joints, JointSamples, Transform, Vector3
from planning.arm import Arm
from planning.robot import flange_pose

_LINE_STEP_M = 0.010


def tcp_line(arm: Arm, q_from_rad: Joints, base_from_tcp: Transform, shift_m: Vector3) -> JointSamples | None:
    """Return the joint path (m, n) that moves the tcp straight by ``shift_m`` (3,) in ``base`` without turning it.

    Each step takes the nearest solution; of the FR3, q7 stays.

    Args:
        q_from_rad: (n,) start; its tcp is at ``base_from_tcp`` (4, 4).

    Returns:
        None when the line leaves the reach or the limits, or when the branch flips (a step above 0.25 rad).
    """
    count = int(np.ceil(np.linalg.norm(shift_m) / _LINE_STEP_M)) + 1
    poses = np.repeat(base_from_tcp[None], max(count, 5), axis=0)
    poses[:, :3, 3] += np.linspace(0.0, 1.0, len(poses))[:, None] * shift_m
    return arm.line(q_from_rad, flange_pose(poses))
