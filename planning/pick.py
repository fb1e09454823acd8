"""From ranked grasps to every motion of one pick.

``reach`` the object along the approach line, ``carry`` it up the lift line to where it is looked at again, ``place`` it
above the tray and down, and ``home``. The first way to grasp for which all four are free and within the limits is
taken; every way before it keeps the reason why not. Same inputs, same bits.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
import numpy.typing as npt

from bus.arrays import Joints, JointSamples, Transform
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Grasp, PickPlan, Rejection, Segment
from config.limits import outside
from planning.candidates import Approach, approaches, configurations, grasp_pose, twins
from planning.carry import steady, upright
from planning.infeasible import Infeasible, summary
from planning.line import tcp_line
from planning.motion import Allowed, Way, connect, motion
from planning.scene import Scene

Array = npt.NDArray[np.float64]

LOWER_M = 0.05
"""Height above the place point from which the object is lowered, and to which the hand retreats."""
_EXAMINED = 16  # arm configurations tried for a place to look from
_LANDINGS = 4  # of them, how many a path may end at
_PLACE_YAWS_RAD = np.arange(12) * np.pi / 6


@dataclass(frozen=True)
class Landing:
    """An arm configuration from which a tcp line is free.

    Attributes:
        q_rad: where the free path may end. ``line_rad``: the line (n, 7) from there.
        leave_rad: the line (m, 7) by which the hand leaves again.
    """

    q_rad: Joints
    line_rad: JointSamples
    leave_rad: JointSamples


def plan_pick(scene: Scene, grasps: Sequence[Grasp], q_now_rad: Joints) -> PickPlan:
    """Choose the first feasible of ``grasps`` (best first) and plan every motion of its pick.

    Args:
        q_now_rad: where the arm rests now.

    Raises:
        CycleFailure: NO_GRASP without grasps; MOTION_REFUSED or COLLISION when the arm cannot start from here;
            UNREACHABLE or COLLISION when no grasp is feasible.
    """
    _check_start(scene, q_now_rad)
    if not grasps:
        raise CycleFailure(Code.NO_GRASP, "There is no grasp to plan for.")
    rejected: list[Rejection] = []
    for approach in approaches(grasps, scene.station):
        try:
            segments = plan_approach(scene, approach, np.asarray(q_now_rad))
        except Infeasible as why:
            rejected.append(
                Rejection(grasp=approach.index, tilt_rad=approach.tilt_rad, code=why.code, reason=why.reason)
            )
            continue
        return PickPlan(grasp=approach.index, tilt_rad=approach.tilt_rad, segments=segments, rejected=tuple(rejected))
    raise _none_feasible(rejected)


def plan_approach(scene: Scene, approach: Approach, q_now_rad: Joints) -> tuple[Segment, ...]:
    """Every motion of the pick by one approach. Raises: Infeasible."""
    base_from_tcp = grasp_pose(approach, scene.station)
    holding = scene.holding(base_from_tcp)
    view_q = _view_configuration(scene.empty(), base_from_tcp[:3, 3])
    reach, carry = _reach_and_carry(scene, holding, approach.grasp, base_from_tcp, q_now_rad, view_q)
    place, home = _place_and_home(holding, approach.grasp, base_from_tcp[:3, :3], view_q)
    return reach, carry, place, home


def plan_reach(scene: Scene, approach: Approach, q_now_rad: Joints) -> Segment:
    """Only the first motion. Raises: Infeasible."""
    grasp, base_from_tcp = approach.grasp, grasp_pose(approach, scene.station)
    return _reach(scene, grasp, base_from_tcp, q_now_rad, lambda _: True)[0]


def _check_start(scene: Scene, q_now_rad: Joints) -> None:
    if not np.isfinite(q_now_rad).all():
        raise CycleFailure(Code.MOTION_REFUSED, "The measured joint positions are not finite numbers.")
    beyond = outside(q_now_rad)
    if beyond is not None:
        raise CycleFailure(Code.MOTION_REFUSED, f"The arm cannot start from where it is: {beyond}.")
    touch = scene.touch(q_now_rad, scene.station.hand.max_width_m)
    if touch is not None:
        raise CycleFailure(Code.COLLISION, f"The arm cannot start from where it is: {touch}.")


def _none_feasible(rejected: Sequence[Rejection]) -> CycleFailure:
    counts = Counter(r.reason for r in rejected).most_common()
    reasons = "; ".join(f"{count} x {reason}" for reason, count in counts)
    code = Code.COLLISION if any(r.code is Code.COLLISION for r in rejected) else Code.UNREACHABLE
    return CycleFailure(code, f"None of {len(rejected)} ways to grasp is feasible: {reasons}.")


# --- reach and carry --------------------------------------------------------------------------------------------------


def _reach_and_carry(
    scene: Scene, holding: Scene, grasp: Grasp, base_from_tcp: Transform, q_now_rad: Joints, view_q: Joints
) -> tuple[Segment, Segment]:
    def calm(landing: Landing) -> bool:
        return steady(scene.robot, landing.leave_rad[-1], view_q)

    reach, landing = _reach(scene, grasp, base_from_tcp, q_now_rad, calm)
    return reach, _carry(scene, holding, grasp, landing, view_q)


def _reach(
    scene: Scene, grasp: Grasp, base_from_tcp: Transform, q_now_rad: Joints, calm: Callable[[Landing], bool]
) -> tuple[Segment, Landing]:
    opening_m = min(grasp.opening_m, scene.station.hand.max_width_m)
    landings = _before_grasp(scene, grasp, base_from_tcp, q_now_rad)
    way, landing = _first_way(scene, q_now_rad, landings, opening_m, calm)
    return motion("reach", way, [*way.lines(), landing.line_rad], scene, opening_m), landing


def _before_grasp(
    scene: Scene, grasp: Grasp, base_from_tcp: Transform, q_now_rad: Joints
) -> Iterator[Landing | Infeasible]:
    """Where the free path may end: before the grasp, with a free approach line and a free lift line."""
    station = scene.station
    back_m = -station.planning.approach_m * base_from_tcp[:3, 2]
    up_m = np.array([0.0, 0.0, station.planning.lift_m])
    opening_m = min(grasp.opening_m, station.hand.max_width_m)
    befores = [_shifted(pose, back_m) for pose in twins(base_from_tcp)]
    for q, before in configurations(befores, q_now_rad):
        try:
            _require_untouched("before the grasp", scene, q, opening_m)
            approach = _line("approach", q, before, -back_m)
            lift = _line("lift", approach[-1], _shifted(before, -back_m), up_m)
            _require_free("approach", scene, approach, opening_m)
            _require_free("lift", scene.empty(), lift, grasp.width_m)
        except Infeasible as why:
            yield why
        else:
            yield Landing(q, approach, lift)


def _first_way(
    scene: Scene,
    q_from_rad: Joints,
    landings: Iterator[Landing | Infeasible],
    width_m: float,
    calm: Callable[[Landing], bool],
    allowed: Allowed | None = None,
) -> tuple[Way, Landing]:
    """A straight way to a calm landing; else a way around to one; else any way to any landing.

    Raises: Infeasible.
    """
    failures: list[Infeasible] = []
    kept: list[tuple[Landing, bool]] = []
    for landing in landings:
        if isinstance(landing, Infeasible):
            failures.append(landing)
            continue
        kept.append((landing, calm(landing)))
        if kept[-1][1] and scene.first_touch(np.stack([q_from_rad, landing.q_rad]), width_m) is None:
            return Way(0, "straight", np.stack([q_from_rad, landing.q_rad])), landing
        if len(kept) == _LANDINGS:
            break
    for some in ([one for one, is_calm in kept if is_calm], [one for one, _ in kept]):
        if some:
            try:
                way = connect(scene, q_from_rad, [one.q_rad for one in some], width_m, allowed)
                return way, some[way.goal]
            except Infeasible as why:
                failures.append(why)
    raise summary(failures, "unreachable: no arm configuration reaches the pose")


def _carry(scene: Scene, holding: Scene, grasp: Grasp, landing: Landing, view_q: Joints) -> Segment:
    lift = landing.leave_rad
    may = upright(scene.robot, lift[-1], view_q)
    way = connect(holding, lift[-1], [view_q], grasp.width_m, may)
    return motion("carry", way, [lift, *way.lines()], holding, grasp.width_m, leaving=scene.empty())


def _view_configuration(scene: Scene, object_m: Array) -> Joints:
    """From where to look again: the capture pose moved aside, the first way the arm reaches; else the pose itself."""
    robot, station = scene.robot, scene.station
    capture_q = np.array(station.arm.capture_q_rad)
    camera_m = robot.base_from_color(capture_q)[:2, 3]
    for aside_m in station.verify.look_aside_m:
        shift_m = np.append(object_m[:2] + aside_m - camera_m, 0.0)
        pose = _shifted(robot.base_from_tcp(capture_q), shift_m)
        for q, _ in islice(configurations([pose], capture_q), _EXAMINED):
            if scene.touch(q, station.hand.max_width_m) is None:
                return q
    return capture_q


# --- place and home ---------------------------------------------------------------------------------------------------


def _place_and_home(
    holding: Scene, grasp: Grasp, base_from_tcp_rotation: Array, view_q: Joints
) -> tuple[Segment, Segment]:
    station, empty, robot = holding.station, holding.empty(), holding.robot
    capture_q, wide_m = np.array(station.arm.capture_q_rad), station.hand.max_width_m

    def calm(landing: Landing) -> bool:
        return steady(robot, view_q, landing.q_rad)

    landings = _above_tray(holding, grasp, base_from_tcp_rotation, view_q)
    way, landing = _first_way(holding, view_q, landings, grasp.width_m, calm, upright(robot, view_q, view_q))
    place = motion("place", way, [*way.lines(), landing.line_rad], holding, grasp.width_m)
    way = connect(empty, landing.leave_rad[-1], [capture_q], wide_m)
    return place, motion("home", way, [landing.leave_rad, *way.lines()], empty, wide_m)


def _above_tray(
    holding: Scene, grasp: Grasp, base_from_tcp_rotation: Array, view_q: Joints
) -> Iterator[Landing | Infeasible]:
    """Above the tray, with a free line down and up again; the object keeps its tilt, its yaw is free."""
    station = holding.station
    down_m = np.array([0.0, 0.0, -LOWER_M])
    above_m = np.array(station.scene.place_m) - down_m
    poses = [_posed(_turned(yaw) @ base_from_tcp_rotation, above_m) for yaw in _PLACE_YAWS_RAD]
    for q, pose in configurations(poses, view_q):
        try:
            _require_untouched("above the tray", holding, q, grasp.width_m)
            lower = _line("lower", q, pose, down_m)
            _require_free("lower", holding, lower, grasp.width_m)
            _require_free("retreat", holding.empty(), lower, station.hand.max_width_m)
        except Infeasible as why:
            yield why
        else:
            yield Landing(q, lower, lower[::-1])


# --- small pieces -----------------------------------------------------------------------------------------------------


def _line(name: str, q_from_rad: Joints, base_from_tcp: Transform, shift_m: Array) -> JointSamples:
    line = tcp_line(q_from_rad, base_from_tcp, shift_m)
    if line is None:
        raise Infeasible(Code.UNREACHABLE, f"{name}: the arm cannot follow the straight line")
    return line


def _require_untouched(name: str, scene: Scene, q_rad: Joints, width_m: float) -> None:
    touch = scene.touch(q_rad, width_m)
    if touch is not None:
        raise Infeasible(Code.COLLISION, f"{name}: {touch}")


def _require_free(name: str, scene: Scene, points_rad: JointSamples, width_m: float) -> None:
    touch = scene.first_touch(points_rad, width_m)
    if touch is not None:
        raise Infeasible(Code.COLLISION, f"{name}: {touch}")


def _shifted(pose: Transform, shift_m: Array) -> Transform:
    return _posed(pose[:3, :3], pose[:3, 3] + shift_m)


def _posed(rotation: Array, position_m: Array) -> Transform:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position_m
    return pose


def _turned(yaw_rad: float) -> Array:
    return np.array([[np.cos(yaw_rad), -np.sin(yaw_rad), 0.0], [np.sin(yaw_rad), np.cos(yaw_rad), 0.0], [0, 0, 1.0]])
