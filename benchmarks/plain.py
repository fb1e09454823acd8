"""A plain pipeline of the libraries, as in their tutorials: OMPL, its simplifier, a spline, and toppra's defaults.

It is the peer of `planning`: without a straight line first, rounded corners, a filter or a gate.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import islice

import numpy as np
import toppra
from ompl import base, geometric, util
from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint

from bus.arrays import Joints, JointSamples, Transform
from bus.trajectory import TICK_S
from config.limits import ACCELERATION_RAD_S2, LOWER_RAD, UPPER_RAD, velocity_bounds
from planning.candidates import configurations, twins
from planning.kinematics import FR3_ARM
from planning.line import tcp_line
from planning.scene import Scene

_GOALS = 4
_EXAMINED = 48
_STEP_RAD = 0.03
_RANGE_RAD = 0.8
_MAX_CHECKS = 20_000
_SIMPLIFYING_CHECKS = 800


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
        for q, pose in islice(configurations(FR3_ARM, befores, q_now_rad), _EXAMINED)
        if scene.collision(q, opening_m) is None
        and (line := tcp_line(FR3_ARM, q, pose, -back_m)) is not None
        and scene.collision(line[-1], opening_m) is None
    ][:_GOALS]
    if not lines:
        return None
    path = _searched(lambda q: scene.collision(q, opening_m) is None, q_now_rad, [line[0] for line in lines])
    if path is None:
        return None
    landing = lines[int(np.argmin([np.abs(line[0] - path[-1]).max() for line in lines]))]
    return _timed(np.concatenate([path[:-1], landing]))


def move(scene: Scene, q_from_rad: Joints, q_to_rad: Joints, width_m: float) -> JointSamples | None:
    """1 kHz commands (n, 7) from rest to rest, or None."""
    path = _searched(lambda q: scene.collision(q, width_m) is None, q_from_rad, [q_to_rad])
    return None if path is None else _timed(path)


def _searched(free: Callable[[Joints], bool], q_from_rad: Joints, goals_rad: Sequence[Joints]) -> JointSamples | None:
    """The vertices (n, 7) of a path to one of the goals, or None; effort is counted in checks, to be deterministic."""
    util.setLogLevel(util.LogLevel.LOG_NONE)
    util.RNG.setSeed(1)
    count = 0

    def counted(state: base.State) -> bool:
        nonlocal count
        count += 1
        return free(np.array([state[joint] for joint in range(7)]))

    info = base.SpaceInformation(_space())
    info.setStateValidityChecker(counted)
    info.setStateValidityCheckingResolution(_STEP_RAD / info.getStateSpace().getMaximumExtent())
    info.setup()
    problem = base.ProblemDefinition(info)
    problem.addStartState(_state(info, q_from_rad))
    goals = base.GoalStates(info)
    for goal in goals_rad:
        goals.addState(_state(info, goal))
    problem.setGoal(goals)
    planner = geometric.RRTConnect(info)
    planner.setRange(_RANGE_RAD)
    planner.setProblemDefinition(problem)
    planner.setup()
    planner.solve(base.PlannerTerminationCondition(lambda: count > _MAX_CHECKS))
    if not problem.hasExactSolution():
        return None
    path, limit = problem.getSolutionPath(), count + _SIMPLIFYING_CHECKS
    geometric.PathSimplifier(info).simplify(path, base.PlannerTerminationCondition(lambda: count > limit))
    return np.array([[path.getState(index)[joint] for joint in range(7)] for index in range(path.getStateCount())])


def _space() -> base.RealVectorStateSpace:
    space = base.RealVectorStateSpace(7)
    bounds = base.RealVectorBounds(7)
    for joint in range(7):
        bounds.setLow(joint, float(LOWER_RAD[joint]))
        bounds.setHigh(joint, float(UPPER_RAD[joint]))
    space.setBounds(bounds)
    return space


def _state(info: base.SpaceInformation, q_rad: Joints) -> base.State:
    state = info.allocState()
    for joint in range(7):
        state[joint] = float(q_rad[joint])
    return state


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
