"""A plain pipeline of the libraries, as in their tutorials: OMPL, its simplifier, a spline, and toppra's defaults.

It is the peer of `planning`: without a straight line first, rounded corners, a filter or a gate.
"""

from __future__ import annotations

from itertools import islice

import numpy as np
import toppra
from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint

from bus.arrays import Joints, JointSamples, Transform
from bus.trajectory import TICK_S
from config.limits import ACCELERATION_RAD_S2, LOWER_RAD, UPPER_RAD, velocity_bounds
from planning.candidates import configurations, twins
from planning.line import tcp_line
from planning.scene import Scene
from planning.search import search

_GOALS = 4
_EXAMINED = 48


def reach(scene: Scene, base_from_tcp: Transform, opening_m: float, q_now_rad: Joints) -> JointSamples | None:
    """1 kHz commands (n, 7) from rest to the grasp, or None."""
    back_m = -scene.station.planning.approach_m * base_from_tcp[:3, 2]
    befores = []
    for pose in twins(base_from_tcp):
        before = pose.copy()
        before[:3, 3] += back_m
        befores.append(before)
    lines = [
        line
        for q, pose in islice(configurations(befores, q_now_rad), _EXAMINED)
        if scene.collision(q, opening_m) is None
        and (line := tcp_line(q, pose, -back_m)) is not None
        and scene.collision(line[-1], opening_m) is None
    ][:_GOALS]
    if not lines:
        return None
    path = search(lambda q: scene.collision(q, opening_m) is None, q_now_rad, [line[0] for line in lines], seed=0)
    if path is None:
        return None
    landing = lines[int(np.argmin([np.abs(line[0] - path[-1]).max() for line in lines]))]
    return _timed(np.concatenate([path[:-1], landing]))


def _timed(waypoints: JointSamples) -> JointSamples | None:
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(waypoints, axis=0), axis=1))])
    speed = velocity_bounds((LOWER_RAD + UPPER_RAD) / 2)[1]
    constraints = [
        JointVelocityConstraint(np.stack([-speed, speed], axis=1)),
        JointAccelerationConstraint(np.stack([-ACCELERATION_RAD_S2, ACCELERATION_RAD_S2], axis=1)),
    ]
    solver = toppra.algorithm.TOPPRA(constraints, toppra.SplineInterpolator(at, waypoints))
    profile = solver.compute_trajectory(0.0, 0.0)
    if profile is None:
        return None
    return np.asarray(profile(np.append(np.arange(0.0, profile.duration, TICK_S), profile.duration)))
