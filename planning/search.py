"""Searches a collision-free joint path where the straight line is blocked: OMPL's RRT-Connect and simplification."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from ompl import base, geometric, util

from bus.arrays import Joints, JointSamples
from bus.errors import CycleFailure
from config.limits import JointLimits

FreeLine = Callable[[Joints, Joints], bool]

LIMIT_MARGIN_RAD = 0.08
"""Distance that paths keep from the position limits, where the allowed velocity goes to 0."""
_RANGE_RAD = 0.4
_MAX_CHECKS = 20_000
_SHORTCUTS = 40


def search(
    limits: JointLimits,
    free_line: FreeLine,
    q_from_rad: Joints,
    goals_rad: Sequence[Joints],
    seed: int,
    spent: Callable[[], int],
) -> JointSamples | None:
    """Return the vertices (m, n) of a path from ``q_from_rad`` (n,) to one of the goals; None if none was found.

    Nothing is searched where the start is not free or no goal is: OMPL would wait for another goal forever.
    Deterministic: effort is counted in checks, not in time.

    Args:
        limits: of the joints.
        free_line: whether the straight line between two configurations is free, its ends included. It is asked for
            every line of the result, or for a longer one that the line is part of.
        goals_rad: goals, each (joints,).
        seed: of OMPL's random numbers.
        spent: number of checks that ``free_line`` has made so far; each call of it counts as one more.

    Raises:
        CycleFailure: the one that ``free_line`` raised.
    """
    limit = spent() + _MAX_CHECKS
    goals_rad = [goal for goal in goals_rad if free_line(goal, goal)]
    if not goals_rad or not free_line(q_from_rad, q_from_rad):
        return None
    util.setLogLevel(util.LogLevel.LOG_NONE)
    util.RNG.setSeed(seed + 1)  # 0 would mean the clock
    info = base.SpaceInformation(_space(limits, [q_from_rad, *goals_rad]))
    lines = _Lines(info, free_line, limits.joints)
    usual = info.getMotionValidator()
    info.setStateValidityChecker(lambda _: True)  # the ends of every line are checked with it
    info.setMotionValidator(lines)
    info.setup()
    try:
        path = _found(info, q_from_rad, goals_rad, lambda: lines.failure is not None or spent() + lines.asked > limit)
        if path is not None:
            _shorten(info, path)
    finally:
        info.setMotionValidator(usual)  # else ``lines`` and ``info`` keep each other alive
    if lines.failure is not None:
        raise lines.failure
    return (
        None
        if path is None
        else np.array([_joints(path.getState(i), limits.joints) for i in range(path.getStateCount())])
    )


def _found(
    info: base.SpaceInformation, q_from_rad: Joints, goals_rad: Sequence[Joints], enough: Callable[[], bool]
) -> geometric.PathGeometric | None:
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
    planner.solve(base.PlannerTerminationCondition(enough))
    return problem.getSolutionPath() if problem.hasExactSolution() else None


def _shorten(info: base.SpaceInformation, path: geometric.PathGeometric) -> None:
    """Shorten the path in place: few vertices, and few attempts that cost many checks."""
    simplifier = geometric.PathSimplifier(info)
    simplifier.collapseCloseVertices(path)
    simplifier.partialShortcutPath(path)
    simplifier.reduceVertices(path)
    simplifier.partialShortcutPath(path, maxSteps=_SHORTCUTS)
    simplifier.collapseCloseVertices(path)


class _Lines(base.MotionValidator):  # type: ignore[misc]
    """Asks for whole lines, not for configurations along them: no edge of a path turns out to touch something later.

    Attributes:
        asked: number of lines so far.
        failure: what was raised instead of an answer: an exception must not pass through OMPL's C++ code.
    """

    def __init__(self, info: base.SpaceInformation, free_line: FreeLine, joints: int) -> None:
        super().__init__(info)
        self._free_line, self._joints = free_line, joints
        self.asked = 0
        self.failure: CycleFailure | None = None

    def checkMotion(self, one: base.State, other: base.State) -> bool:
        """Whether the straight line between two states is free; no line is after a failure."""
        self.asked += 1
        try:
            return self.failure is None and self._free_line(_joints(one, self._joints), _joints(other, self._joints))
        except CycleFailure as failure:
            self.failure = failure
            return False


def _space(limits: JointLimits, inside: Sequence[Joints]) -> base.RealVectorStateSpace:
    """Return all configurations off the limits; start and goals may lie nearer to them."""
    space = base.RealVectorStateSpace(limits.joints)
    bounds = base.RealVectorBounds(limits.joints)
    lows = np.minimum(limits.lower_rad + LIMIT_MARGIN_RAD, np.min(inside, axis=0))
    highs = np.maximum(limits.upper_rad - LIMIT_MARGIN_RAD, np.max(inside, axis=0))
    for joint in range(limits.joints):
        bounds.setLow(joint, float(lows[joint]))
        bounds.setHigh(joint, float(highs[joint]))
    space.setBounds(bounds)
    return space


def _state(info: base.SpaceInformation, q_rad: Joints) -> base.State:
    state = info.allocState()
    for joint, value in enumerate(q_rad):
        state[joint] = float(value)
    return state


def _joints(state: base.State, count: int) -> Joints:
    return np.array([state[joint] for joint in range(count)])
