"""The needs of a felt approach: where the arm feels, how far before the grasp it may close, and its ways on or back.

Frames: docs/frames.md.
"""

from __future__ import annotations

import numpy as np

from bus.arrays import Joints, JointSamples
from bus.trajectory import ContactGuard, Trajectory
from config.franka_hand import FINGER_TIP_M
from config.schema import Station
from planning.blend import Curve
from planning.robot import Robot
from planning.timing import timed

_ROWS = 32
_STEEP = 0.5
_HELD_BY_TIPS_M = 0.001
"""So much of the tips, at least, is to be beyond that line, and below the top."""
_FADE = 0.6
"""Share of the lift line on which a carry is joined."""
_POINTS = 301
_EVERY_TICKS = 4
_STILL_RAD = 1e-9
_NEAR_RAD = 5e-3
"""On so short a piece the approach line is straight for the joints, too."""


def guard(robot: Robot, reach: Trajectory, begins_at: int, limit_n: float) -> ContactGuard:
    """Return the guard of ``reach`` from the tick ``begins_at`` of its filtered motion, where its line begins.

    The force is the one at the tcp that explains the external torques (`Robot.tcp_force_n`), against the direction in
    which the tcp moves along that line.
    """
    commands = reach.filtered()
    q_rad = commands[np.linspace(begins_at, len(commands) - 1, _ROWS).round().astype(int)]
    line_m = robot.base_from_tcp(q_rad[-1])[:3, 3] - robot.base_from_tcp(q_rad[0])[:3, 3]
    against = -line_m / max(float(np.linalg.norm(line_m)), 1e-12)
    weights = np.array([against @ np.linalg.pinv(robot.jacobian(q).T)[:3] for q in q_rad])
    return ContactGuard(begins_at=begins_at, limit_n=limit_n, force_from_torque=weights)


def closes_within_m(robot: Robot, grasp_q_rad: Joints, top_m: float | None) -> float:
    """Return how far before the grasp the fingers may close after a contact, because their tips reach the thing [m].

    The tips are `FINGER_TIP_M` beyond the tcp. So far before the grasp they end where the tcp was to be, on the line on
    which the grasp holds the thing; they also must be below its top.

    Args:
        grasp_q_rad: (joints,) the arm at the grasp.
        top_m: highest point of the thing in ``base``; None = unknown.
    """
    pose = robot.base_from_tcp(grasp_q_rad)
    down = -float(pose[2, 2])
    reaches_m = FINGER_TIP_M
    if top_m is not None and down > _STEEP:
        reaches_m = min(reaches_m, (top_m - float(pose[2, 3])) / down + FINGER_TIP_M)
    return reaches_m - _HELD_BY_TIPS_M


def way_back(station: Station, commanded_q_rad: JointSamples) -> Trajectory:
    """Return the motion back along all of what was commanded (n, joints), to where it began.

    Where the arm braked and went back a little, it does not go there again.

    Raises:
        CycleFailure: MOTION_REFUSED, as `planning.timing.timed`.
    """
    rests = commanded_q_rad[-1]
    passed = int(np.argmax(np.linalg.norm(commanded_q_rad - rests, axis=1) < _NEAR_RAD))
    return timed(station, _curve(np.concatenate([rests[None], commanded_q_rad[passed::-1]])))


def joined(robot: Robot, station: Station, carry: Trajectory, q_rad: Joints) -> Trajectory:
    """Return ``carry`` from where the arm is, a little above its start, instead of from there.

    The difference fades out on the lift line, so that the tcp stays between that line and the approach line.

    Args:
        q_rad: (joints,) where the arm is.

    Raises:
        CycleFailure: MOTION_REFUSED, as `planning.timing.timed`.
    """
    curve = _curve(carry.filtered())
    lifted_m = np.array([robot.base_from_tcp(q)[:3, 3] for q in curve.points_rad])
    share = np.linalg.norm(lifted_m - lifted_m[0], axis=1) / (_FADE * station.planning.lift_m)
    share = np.maximum.accumulate(np.clip(share, 0.0, 1.0))
    rest = 1.0 - share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    return timed(station, _curve(curve.points_rad + rest[:, None] * (q_rad - carry.start_q_rad)))


def lifted_at(robot: Robot, station: Station, commands: JointSamples) -> int:
    """Return the tick of a carry's ``commands`` (m, n) at which it is on its planned way again, on the lift line."""
    lifted_m = np.array([robot.base_from_tcp(q)[:3, 3] for q in commands[::_EVERY_TICKS]])
    far = np.linalg.norm(lifted_m - lifted_m[0], axis=1) >= _FADE * station.planning.lift_m
    return int(np.argmax(far)) * _EVERY_TICKS if far.any() else len(commands) - 1


def _curve(path_rad: JointSamples) -> Curve:
    """Return the curve through ``path_rad`` (n, joints), with evenly spaced points."""
    steps = np.linalg.norm(np.diff(path_rad, axis=0), axis=1)
    moved = np.concatenate([[True], steps > _STILL_RAD])
    at = np.concatenate([[0.0], np.cumsum(steps)])[moved]
    even = np.linspace(0.0, at[-1], _POINTS)
    points = np.stack([np.interp(even, at, column) for column in path_rad[moved].T], axis=1)
    return Curve(even, points, ())
