"""Searches a collision-free joint path where the straight line is blocked: OMPL's RRT-Connect and simplification."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from ompl import base, geometric, util

from bus.arrays import Joints, JointSamples
from bus.errors import CycleFailure
from config.limits import LOWER_RAD, UPPER_RAD

Free = Callable[[Joints], bool]

LIMIT_MARGIN_RAD = 0.08
"""Distance that paths keep from the position limits, where the allowed velocity goes to 0."""
_STEP_RAD = 0.03
_RANGE_RAD = 0.8
_MAX_CHECKS = 20_000
_SIMPLIFYING_CHECKS = 800


def search(
    free: Free, q_from_rad: Joints, goals_rad: Sequence[Joints], seed: int, *, simplify: bool = True
) -> JointSamples | None:
    """Return the vertices (n, 7) of a path from ``q_from_rad`` (7,) to one of the goals; None if none was found.

    A start or goals that are not allowed are no path: OMPL would wait for a better goal for ever, without a check.

    Deterministic: effort is counted in checks, not in time.

    Args:
        free: whether a configuration is allowed. It is called every 0.03 rad: check the result more finely.
        goals_rad: goals, each (7,).
        seed: of OMPL's random numbers.
        simplify: shorten the path that was found.

    Raises:
        CycleFailure: the one that ``free`` raised.
    """
    goals_rad = [goal for goal in goals_rad if free(goal)]
    if not goals_rad or not free(q_from_rad):
        return None
    util.setLogLevel(util.LogLevel.LOG_NONE)
    util.RNG.setSeed(seed + 1)  # 0 would mean the clock
    count = 0
    ended: list[CycleFailure] = []  # an exception must not pass through OMPL's C++ code

    def counted(state: base.State) -> bool:
        nonlocal count
        count += 1
        try:
            return not ended and free(_joints(state))
        except CycleFailure as failure:
            ended.append(failure)
            return False

    space = _space([q_from_rad, *goals_rad])
    info = base.SpaceInformation(space)
    info.setStateValidityChecker(counted)
    info.setStateValidityCheckingResolution(_STEP_RAD / space.getMaximumExtent())
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
    planner.solve(base.PlannerTerminationCondition(lambda: bool(ended) or count > _MAX_CHECKS))
    if ended:
        raise ended[0]
    if not problem.hasExactSolution():
        return None
    path = problem.getSolutionPath()
    if simplify:
        limit = count + _SIMPLIFYING_CHECKS
        enough = base.PlannerTerminationCondition(lambda: bool(ended) or count > limit)
        geometric.PathSimplifier(info).simplify(path, enough)
        if ended:
            raise ended[0]
    return np.array([_joints(path.getState(index)) for index in range(path.getStateCount())])


def _space(inside: Sequence[Joints]) -> base.RealVectorStateSpace:
    """Return all configurations off the limits; start and goals may lie nearer to them."""
    space = base.RealVectorStateSpace(7)
    bounds = base.RealVectorBounds(7)
    lows = np.minimum(LOWER_RAD + LIMIT_MARGIN_RAD, np.min(inside, axis=0))
    highs = np.maximum(UPPER_RAD - LIMIT_MARGIN_RAD, np.max(inside, axis=0))
    for joint in range(7):
        bounds.setLow(joint, float(lows[joint]))
        bounds.setHigh(joint, float(highs[joint]))
    space.setBounds(bounds)
    return space


def _state(info: base.SpaceInformation, q_rad: Joints) -> base.State:
    state = info.allocState()
    for joint in range(7):
        state[joint] = float(q_rad[joint])
    return state


def _joints(state: base.State) -> Joints:
    return np.array([state[joint] for joint in range(7)])
