"""Picks in random scenes: success rate, planning time, and violations of limits or collisions by any command."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks import plain
from benchmarks.judge import Judge, judge_of, optimal_s, stopped
from benchmarks.numeric_ik import numeric_inverse, reachable_poses
from benchmarks.picks import Problem, problems, station
from bus.messages import Segment
from bus.trajectory import Trajectory
from config.limits import FR3, LimitReport, check
from planning.arm import limit_distance_rad
from planning.candidates import configurations, grasp_pose
from planning.infeasible import Infeasible
from planning.kinematics import FR3_ARM, branches, q7_grid
from planning.pick import plan_approach, plan_reach
from planning.robot import Robot, flange_pose

Array = npt.NDArray[np.float64]
Tell = Callable[[str], None]

_IK_POSES = 300


@dataclass
class _Tally:
    """The results of the problems so far."""

    solved: list[bool] = field(default_factory=list)
    plan_ms: list[float] = field(default_factory=list)
    cycle_ms: list[float] = field(default_factory=list)
    over_topt: list[float] = field(default_factory=list)
    reports: list[LimitReport] = field(default_factory=list)
    collisions: int = 0
    searched: int = 0
    reasons: list[str] = field(default_factory=list)
    stop_s: list[float] = field(default_factory=list)
    off_path_rad: list[float] = field(default_factory=list)
    stop_reports: list[LimitReport] = field(default_factory=list)


def run(scenes: int, seed: int, tell: Tell) -> dict[str, Any]:
    """Four picks in each of ``scenes`` scenes; every second scene is known only as a cloud. Times are CPU times."""
    robot = Robot(station())
    rng = np.random.default_rng([seed, 1])
    ours = {False: _Tally(), True: _Tally()}
    peer = {False: _Tally(), True: _Tally()}
    plan_approach_once(robot)
    for problem in problems(robot, scenes, seed):
        judge = judge_of(robot, problem)
        _solve(robot, problem, judge, ours[problem.seen_only], rng)
        _solve_plainly(robot, problem, judge, peer[problem.seen_only])
        if (problem.number + 1) % 20 == 0:
            tell(f"{problem.number + 1}/{4 * scenes}")
    return {**_figures(ours), "ik": _ik(robot, seed), "peak_mb": _peak_mb(), "peer": _peer_figures(peer)}


def plan_approach_once(robot: Robot) -> None:
    """Load what is loaded once: hulls of the parts, libraries."""
    problem = next(problems(robot, 1, 12345))
    plan_approach(problem.scene(robot), problem.approach, _capture_q(robot))


def _solve(robot: Robot, problem: Problem, judge: Judge, tally: _Tally, rng: np.random.Generator) -> None:
    began_s = time.process_time()
    scene = problem.scene(robot)
    try:
        segments = plan_approach(scene, problem.approach, _capture_q(robot))
    except Infeasible as why:
        tally.solved.append(False)
        tally.reasons.append(why.reason)
        return
    tally.solved.append(True)
    tally.cycle_ms.append(1e3 * (time.process_time() - began_s))
    began_s = time.process_time()
    plan_reach(scene, problem.approach, _capture_q(robot))
    tally.plan_ms.append(1e3 * (time.process_time() - began_s))
    _judge(robot, problem, judge, segments, tally, rng)


def _judge(
    robot: Robot,
    problem: Problem,
    judge: Judge,
    segments: Sequence[Segment],
    tally: _Tally,
    rng: np.random.Generator,
) -> None:
    grasp = problem.approach.grasp
    widths_m = {"reach": grasp.opening_m, "home": robot.station.hand.max_width_m}
    base_from_tcp = robot.base_from_tcp(segments[0].trajectory.end_q_rad)
    for segment in segments:
        trajectory = segment.trajectory
        tally.reports.append(check(trajectory.filtered()))
        tally.over_topt.append(trajectory.duration_s / optimal_s(trajectory))
        touched = judge.touches(trajectory, widths_m.get(segment.name, grasp.width_m))
        if segment.name in ("carry", "place"):
            touched = touched or judge.held_touches(trajectory, base_from_tcp, problem)
        tally.collisions += touched
        tally.searched += segment.route == "searched"
        _stop(trajectory, float(rng.uniform()), tally)


def _stop(trajectory: Trajectory, share: float, tally: _Tally) -> None:
    stop_s, off_path_rad, commands = stopped(trajectory, share)
    tally.stop_s.append(stop_s)
    tally.off_path_rad.append(off_path_rad)
    tally.stop_reports.append(check(commands))


def _solve_plainly(robot: Robot, problem: Problem, judge: Judge, tally: _Tally) -> None:
    """The same reach by what a user of the libraries would write first; see `benchmarks.plain`."""
    scene = problem.scene(robot)
    pose = grasp_pose(problem.approach, robot.station)
    began_s = time.process_time()
    commands = plain.reach(scene, pose, problem.approach.grasp.opening_m, _capture_q(robot))
    tally.solved.append(commands is not None)
    if commands is None:
        return
    tally.plan_ms.append(1e3 * (time.process_time() - began_s))
    trajectory = Trajectory(raw_q_rad=commands, window=1)
    tally.reports.append(check(commands))
    tally.over_topt.append(trajectory.duration_s / optimal_s(trajectory))
    tally.collisions += judge.touches(trajectory, problem.approach.grasp.opening_m)


def _ik(robot: Robot, seed: int) -> dict[str, Any]:
    """Of the poses that a 20-restart numeric solver reaches, the share that the closed form reaches."""
    poses = reachable_poses(_IK_POSES, seed)
    found = reached = 0
    times_us = []
    for index, pose in enumerate(poses):
        began_s = time.process_time()
        next(configurations(FR3_ARM, [pose], _capture_q(robot)), None)
        times_us.append(1e6 * (time.process_time() - began_s))
        if numeric_inverse(robot, pose, restarts=20, seed=index) is not None:
            reached += 1
            found += bool((limit_distance_rad(FR3, branches(flange_pose(pose), q7_grid())) >= 0).any())
    return {
        "poses": len(poses),
        "numeric": reached,
        "success": found / reached,
        "median_us": rounded(np.median(times_us)),
    }


def _figures(tallies: dict[bool, _Tally]) -> dict[str, Any]:
    def every(name: str) -> list[Any]:
        return [value for tally in tallies.values() for value in getattr(tally, name)]

    return {
        "problems": len(every("solved")),
        "solved": {
            "known": float(np.mean(tallies[False].solved)),
            "cloud_only": float(np.mean(tallies[True].solved)),
        },
        "unsolved": sorted(set(every("reasons"))),
        "motions": len(every("reports")),
        "searched": sum(tally.searched for tally in tallies.values()),
        "plan_ms": spread(every("plan_ms")),
        "cycle_plan_ms": spread(every("cycle_ms")),
        "cycle_plan_ms_known": spread(tallies[False].cycle_ms),
        "motion_over_topt": spread(every("over_topt"), 4),
        "limit_violations": sum(not report.ok for report in [*every("reports"), *every("stop_reports")]),
        "collisions_independent": sum(tally.collisions for tally in tallies.values()),
        "worst_ratio": {
            kind: rounded(max(getattr(report, kind).ratio for report in every("reports")), 4)
            for kind in ("velocity", "acceleration", "jerk")
        },
        "stop_s": {**spread(every("stop_s"), 3), "max": rounded(max(every("stop_s")), 3)},
        "stop_off_path_rad_max": float(f"{max(every('off_path_rad')):.2g}"),
    }


def _peer_figures(tallies: dict[bool, _Tally]) -> dict[str, Any]:
    both = tallies.values()
    reports = [report for tally in both for report in tally.reports]
    return {
        "what": "the reach alone: RRT-Connect and PathSimplifier of OMPL, spline, toppra with its defaults",
        "solved": {
            "known": float(np.mean(tallies[False].solved)),
            "cloud_only": float(np.mean(tallies[True].solved)),
        },
        "plan_ms": spread([ms for tally in both for ms in tally.plan_ms]),
        "motion_over_topt": spread([ratio for tally in both for ratio in tally.over_topt], 4),
        "limit_violations": sum(not report.ok for report in reports),
        "collisions_independent": sum(tally.collisions for tally in both),
        "worst_ratio": {
            kind: rounded(max(getattr(report, kind).ratio for report in reports), 3)
            for kind in ("velocity", "acceleration", "jerk")
        },
    }


def spread(values: Sequence[float], digits: int = 1) -> dict[str, float]:
    return {"median": rounded(np.median(values), digits), "p95": rounded(np.percentile(values, 95), digits)}


def rounded(value: Any, digits: int = 1) -> float:
    return round(float(value), digits)


def _capture_q(robot: Robot) -> Array:
    return np.array(robot.station.arm.capture_q_rad)


def _peak_mb() -> float:
    return rounded(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
