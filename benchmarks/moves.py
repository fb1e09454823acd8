"""Moves of MotionBenchMaker's problems: solved, CPU time limits, collisions; and plain libraries."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

from benchmarks import plain
from benchmarks.judge import Judge
from benchmarks.motionbench import Problem, problems
from benchmarks.picks import station
from benchmarks.planning import rounded, spread
from bus.codes import Code
from bus.errors import CycleFailure
from bus.trajectory import Trajectory
from config.limits import check
from planning.motion import move
from planning.robot import Robot
from planning.scene import Scene

Tell = Callable[[str], None]


@dataclass
class _Tally:
    """The results of the solvable problems."""

    unsolved: list[str] = field(default_factory=list)
    plan_ms: list[float] = field(default_factory=list)
    failed_ms: list[float] = field(default_factory=list)
    motion_s: list[float] = field(default_factory=list)
    limit_violations: int = 0
    collisions: int = 0

    def add(self, trajectory: Trajectory, plan_ms: float, judge: Judge, width_m: float) -> None:
        self.plan_ms.append(plan_ms)
        self.motion_s.append(trajectory.duration_s)
        self.limit_violations += not check(trajectory.filtered()).ok
        self.collisions += judge.touches(trajectory, width_m)

    def figures(self) -> dict[str, Any]:
        solved, tried = len(self.plan_ms), len(self.plan_ms) + len(self.failed_ms)
        return {
            "solved": solved,
            "solved_share": rounded(solved / max(1, tried), 3),
            "unsolved": self.unsolved,
            "plan_ms": _spread(self.plan_ms),
            "failed_ms": _spread(self.failed_ms),
            "motion_s": _spread(self.motion_s, 2),
            "limit_violations": self.limit_violations,
            "collisions_independent": self.collisions,
        }


@dataclass
class _Part:
    """One part of the problems, and what this planner and its peer made of them."""

    read: int = 0
    within_limits: int = 0
    usable: int = 0
    by_set: Counter[str] = field(default_factory=Counter)
    refused_ms: list[float] = field(default_factory=list)
    refused_otherwise: list[str] = field(default_factory=list)
    ours: _Tally = field(default_factory=_Tally)
    peer: _Tally = field(default_factory=_Tally)

    def figures(self) -> dict[str, Any]:
        return {
            "problems": self.read,
            "within_limits": self.within_limits,
            "usable": self.usable,
            "usable_by_set": dict(self.by_set),
            "solvable": self.usable - len(self.refused_ms),
            **self.ours.figures(),
            "refused": len(self.refused_ms),
            "refused_ms_max": rounded(max(self.refused_ms, default=0.0)),
            "refused_otherwise": self.refused_otherwise,
            "peer": {"what": "RRT-Connect and PathSimplifier of OMPL, spline, toppra with its defaults"}
            | self.peer.figures(),
        }


def run(path: Path, every: int, offsets: Sequence[int], tell: Tell) -> dict[str, Any]:
    """Every ``every``-th problem of the archive, from each of the offsets on. Times are CPU times."""
    robot = Robot(station())
    for problem in islice(problems(path, 1, 0), 1):
        _plan(problem.scene(robot), problem)  # loads what is loaded once
    return {"every": every, "offsets": {str(offset): _part(robot, path, every, offset, tell) for offset in offsets}}


def _part(robot: Robot, path: Path, every: int, offset: int, tell: Tell) -> dict[str, Any]:
    part = _Part()
    for problem in problems(path, every, offset):
        part.read += 1
        if problem.is_within_limits():
            part.within_limits += 1
            _measure(robot, problem, part)
        if part.read % 20 == 0:
            tell(f"offset {offset}: {part.read} read, {part.usable} usable, {len(part.ours.plan_ms)} solved")
    return part.figures()


def _measure(robot: Robot, problem: Problem, part: _Part) -> None:
    if not problem.is_free(problem.scene(robot)):
        return
    part.usable += 1
    part.by_set[problem.name.partition("/")[0]] += 1
    planned, plan_ms = _timed(lambda: _plan(problem.scene(robot), problem))
    if not problem.may_move_at_ends():
        part.refused_ms.append(plan_ms)
        if not (isinstance(planned, CycleFailure) and planned.failure is Code.MOTION_REFUSED):
            part.refused_otherwise.append(f"{problem.name}: {planned}")
        return
    width_m = robot.station.hand.max_width_m
    judge = Judge(robot, [(thing.shape, thing.pose) for thing in problem.obstacles], floors=0)
    if isinstance(planned, CycleFailure):
        part.ours.failed_ms.append(plan_ms)
        part.ours.unsolved.append(f"{problem.name}: {planned.text}")
    else:
        part.ours.add(planned, plan_ms, judge, width_m)
    commands, plan_ms = _timed(lambda: plain.move(problem.scene(robot), *problem.ends_rad, width_m))
    if commands is None:
        part.peer.failed_ms.append(plan_ms)
    else:
        part.peer.add(Trajectory(raw_q_rad=commands, window=1), plan_ms, judge, width_m)


def _plan(scene: Scene, problem: Problem) -> Trajectory | CycleFailure:
    try:
        return move(scene, *problem.ends_rad)
    except CycleFailure as failure:
        return failure


def _timed(make: Callable[[], Any]) -> tuple[Any, float]:
    began_s = time.process_time()
    made = make()
    return made, 1e3 * (time.process_time() - began_s)


def _spread(values: Sequence[float], digits: int = 1) -> dict[str, float] | None:
    return spread(values, digits) if values else None
