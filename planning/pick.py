"""From ranked grasps to every motion of one pick.

``transit`` to before the object, ``approach`` along the tcp, ``lift`` straight up, ``view`` from aside, ``place``
above the tray, ``lower``, ``retreat`` and ``home``. The first grasp for which all of them are free and within the
limits is taken; every grasp before it keeps the reason why not. Same inputs, same bits: nothing here is random.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice

import numpy as np
import numpy.typing as npt

from bus.arrays import Joints, JointSamples, Transform
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Grasp, PickPlan, Rejection, Segment, SegmentName
from config.limits import outside
from config.schema import Station
from planning.kinematics import cost, inverse, limit_distance_rad, q7_grid
from planning.path import first_collision, flange_pose, tcp_line
from planning.robot import FINGER_CLEARANCE_M, FINGER_TIP_M, FINGER_TIP_SIZE_M, Robot
from planning.timing import gated

Array = npt.NDArray[np.float64]

LOWER_M = 0.05
"""Height above the place point from which the object is lowered, and to which the hand retreats."""
MAX_RAISE_M = 0.015
"""How far a grasp may be raised to keep the finger tips off the table; more would miss the object."""
CARRY_DIP_M = 0.02
CARRY_TILT_RAD = np.radians(20.0)
"""How far a held object may sink below both ends of a joint line, and tilt beyond the angle between them."""
_LIMIT_MARGIN_RAD = 0.08  # the allowed velocity goes to 0 at the limits
_CANDIDATES = 16  # arm configurations checked for collisions for one pose
_PLACE_YAWS_RAD = np.arange(12) * np.pi / 6


class _Infeasible(Exception):
    """One way to do it does not work."""

    def __init__(self, code: Code, reason: str) -> None:
        super().__init__(reason)
        self.code = code
        self.reason = reason


Step = tuple[SegmentName, JointSamples, float]
"""Name, joint path (m, 7), and the width of the hand meanwhile [m]."""


def plan_pick(robot: Robot, station: Station, grasps: Sequence[Grasp], q_now_rad: Joints) -> PickPlan:
    """Choose the first feasible of ``grasps`` (best first) and plan every motion of its pick.

    Args:
        q_now_rad: where the arm rests now.

    Raises:
        CycleFailure: NO_GRASP without grasps; MOTION_REFUSED or COLLISION when the arm cannot start from here;
            UNREACHABLE or COLLISION when no grasp is feasible.
    """
    _check_start(robot, q_now_rad)
    if not grasps:
        raise CycleFailure(Code.NO_GRASP, "There is no grasp to plan for.")
    rejected: list[Rejection] = []
    for index, grasp in enumerate(grasps[: station.planning.max_grasps]):
        try:
            segments = _plan_grasp(robot, station, grasp, np.asarray(q_now_rad))
        except _Infeasible as why:
            rejected.append(Rejection(grasp=index, code=why.code, reason=why.reason))
            continue
        return PickPlan(grasp=index, segments=segments, rejected=tuple(rejected))
    raise _none_feasible(rejected)


def _check_start(robot: Robot, q_now_rad: Joints) -> None:
    if not np.isfinite(q_now_rad).all():
        raise CycleFailure(Code.MOTION_REFUSED, "The measured joint positions are not finite numbers.")
    beyond = outside(q_now_rad)
    if beyond is not None:
        raise CycleFailure(Code.MOTION_REFUSED, f"The arm cannot start from where it is: {beyond}.")
    touch = robot.collision(q_now_rad)
    if touch is not None:
        raise CycleFailure(Code.COLLISION, f"The arm cannot start from where it is: {touch}.")


def _none_feasible(rejected: Sequence[Rejection]) -> CycleFailure:
    counts = Counter(r.reason for r in rejected).most_common()
    reasons = "; ".join(f"{count} x {reason}" for reason, count in counts)
    code = Code.COLLISION if any(r.code is Code.COLLISION for r in rejected) else Code.UNREACHABLE
    return CycleFailure(code, f"None of {len(rejected)} grasps is feasible: {reasons}.")


def _plan_grasp(robot: Robot, station: Station, grasp: Grasp, q_now_rad: Joints) -> tuple[Segment, ...]:
    _check_grasp(grasp)
    base_from_tcp = _off_the_table(station, grasp)
    view_q = _view_configuration(robot, station, base_from_tcp[:3, 3])
    steps = _pick_steps(robot, station, grasp, base_from_tcp, q_now_rad, view_q)
    steps += _place_steps(robot, station, grasp, base_from_tcp[:3, :3], view_q)
    segments = []
    for name, points, width_m in steps:
        try:
            trajectory = gated(robot, points, width_m=width_m)
        except CycleFailure as why:
            raise _Infeasible(why.failure, f"{name}: {why.text}") from why
        segments.append(Segment(name=name, trajectory=trajectory))
    return tuple(segments)


def _check_grasp(grasp: Grasp) -> None:
    pose = grasp.base_from_tcp
    if not (np.isfinite(pose).all() and np.isfinite([grasp.width_m, grasp.opening_m]).all()):
        raise _Infeasible(Code.UNREACHABLE, "the grasp is not made of finite numbers")
    rotation = pose[:3, :3]
    if np.abs(rotation.T @ rotation - np.eye(3)).max() > 1e-6 or np.linalg.det(rotation) < 0:
        raise _Infeasible(Code.UNREACHABLE, "the grasp's orientation is not a rotation")


def _off_the_table(station: Station, grasp: Grasp) -> Transform:
    """The grasp, raised as far as its finger tips need to clear the table."""
    pose = np.array(grasp.base_from_tcp)
    half_x, half_y = FINGER_TIP_SIZE_M[0] / 2, grasp.opening_m / 2 + FINGER_TIP_SIZE_M[1]
    corners = np.array([[x, y, FINGER_TIP_M] for x in (-half_x, half_x) for y in (-half_y, half_y)])
    lowest_m = float((corners @ pose[:3, :3].T)[:, 2].min() + pose[2, 3])
    table_m = station.scene.table.center_m[2] + station.scene.table.size_m[2] / 2
    raise_m = table_m + FINGER_CLEARANCE_M + 5e-4 - lowest_m
    if raise_m > MAX_RAISE_M:
        raise _Infeasible(Code.COLLISION, "the grasp is so low that the fingers would touch table")
    pose[2, 3] += max(0.0, raise_m)
    return pose


def _pick_steps(
    robot: Robot, station: Station, grasp: Grasp, base_from_tcp: Transform, q_now_rad: Joints, view_q: Joints
) -> list[Step]:
    """transit, approach, lift and view, for the best arm configuration that can do all four."""
    back = -station.planning.approach_m * base_from_tcp[:3, 2]
    up = np.array([0.0, 0.0, station.planning.lift_m])
    wide, opening = station.hand.max_width_m, min(grasp.opening_m, station.hand.max_width_m)
    half_turn = np.diag([-1.0, -1.0, 1.0, 1.0])

    def steps(q: Joints, pose: Transform) -> list[Step]:
        approach = _line("approach", q, pose, -back)
        lift = _line("lift", approach[-1], _shifted(pose, -back), up)
        return [
            ("transit", np.stack([q_now_rad, q]), wide),
            ("approach", approach, opening),
            ("lift", lift, grasp.width_m),
            ("view", np.stack([lift[-1], view_q]), grasp.width_m),
        ]

    twins = [_shifted(pose, back) for pose in (base_from_tcp, base_from_tcp @ half_turn)]
    return _first_free(robot, _configurations(robot, twins, q_now_rad), steps, "the pose before the grasp")


def _view_configuration(robot: Robot, station: Station, object_m: Array) -> Joints:
    """From where to look again: the capture pose moved aside, the first way the arm reaches; else the pose itself."""
    capture_q = np.array(station.arm.capture_q_rad)
    camera_m = robot.base_from_color(capture_q)[:2, 3]
    for aside_m in station.verify.look_aside_m:
        shift_m = np.append(object_m[:2] + aside_m - camera_m, 0.0)
        pose = _shifted(robot.base_from_tcp(capture_q), shift_m)
        for q, _ in islice(_configurations(robot, [pose], capture_q), _CANDIDATES):
            if robot.collision(q) is None:
                return q
    return capture_q


def _place_steps(
    robot: Robot, station: Station, grasp: Grasp, base_from_tcp_rotation: Array, view_q: Joints
) -> list[Step]:
    """place, lower, retreat and home; the object keeps its tilt, its yaw is free."""
    capture_q = np.array(station.arm.capture_q_rad)
    wide, down = station.hand.max_width_m, np.array([0.0, 0.0, -LOWER_M])
    poses = []
    for yaw in _PLACE_YAWS_RAD:
        pose = np.eye(4)
        turn = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
        pose[:3, :3], pose[:3, 3] = turn @ base_from_tcp_rotation, np.array(station.scene.place_m) - down
        poses.append(pose)

    def steps(q: Joints, pose: Transform) -> list[Step]:
        lower = _line("lower", q, pose, down)
        return [
            ("place", np.stack([view_q, q]), grasp.width_m),
            ("lower", lower, grasp.width_m),
            ("retreat", lower[::-1], wide),
            ("home", np.stack([q, capture_q]), wide),
        ]

    return _first_free(robot, _configurations(robot, poses, view_q), steps, "the pose above the tray")


def _first_free(
    robot: Robot,
    configurations: Iterable[tuple[Joints, Transform]],
    steps_from: Callable[[Joints, Transform], list[Step]],
    goal: str,
) -> list[Step]:
    """The motions from the first configuration whose motions exist and touch nothing; steady ones are preferred."""
    failures: list[_Infeasible] = []
    steady: list[list[Step]] = []
    swinging: list[list[Step]] = []
    for q, pose in configurations:
        try:
            steps = steps_from(q, pose)
        except _Infeasible as why:
            failures.append(why)
            continue
        (steady if _swing(robot, steps) <= 1.0 else swinging).append(steps)
        if len(steady) == _CANDIDATES:
            break
    for steps in (steady + swinging)[:_CANDIDATES]:
        try:
            _require_free(robot, steps)
        except _Infeasible as why:
            failures.append(why)
        else:
            return steps
    collisions = [f for f in failures if f.code is Code.COLLISION]
    raise _summary(collisions or failures, f"no arm configuration reaches {goal}")


def _configurations(robot: Robot, poses: Sequence[Transform], q_from_rad: Joints) -> Iterator[tuple[Joints, Transform]]:
    """The best arm configurations that bring the tcp to any of ``poses``, cheapest first."""
    solutions = [inverse(flange_pose(pose), q7_grid()) for pose in poses]
    owner = np.repeat(np.arange(len(poses)), [len(s) for s in solutions])
    q = np.concatenate(solutions)
    kept = limit_distance_rad(q) >= _LIMIT_MARGIN_RAD
    q, owner = q[kept], owner[kept]
    costs = cost(q_from_rad, q, np.array([robot.manipulability(each) for each in q]))
    for index in np.argsort(costs, kind="stable"):
        yield q[index], poses[owner[index]]


def _line(name: SegmentName, q_from_rad: Joints, base_from_tcp: Transform, shift_m: Array) -> JointSamples:
    line = tcp_line(q_from_rad, base_from_tcp, shift_m)
    if line is None:
        raise _Infeasible(Code.UNREACHABLE, f"{name}: the arm cannot follow the straight line")
    return line


def _require_free(robot: Robot, steps: Sequence[Step]) -> None:
    for name, points, width_m in sorted(steps, key=lambda step: -len(step[1])):  # tcp lines first: short and low
        touch = first_collision(robot, points, width_m=width_m)
        if touch is not None:
            raise _Infeasible(Code.COLLISION, f"{name}: {touch}")


def _swing(robot: Robot, steps: Sequence[Step]) -> float:
    """How much the joint lines that carry the object drag or tip it; 1 = just acceptable."""
    worst = 0.0
    for name, points, _ in steps:
        if name in ("view", "place"):
            poses = np.stack([robot.base_from_tcp(q) for q in np.linspace(points[0], points[-1], 21)])
            heights_m, axes = poses[:, 2, 3], poses[:, :3, 2]
            turned = np.arccos(np.clip(axes @ axes[0], -1.0, 1.0))
            dip_m = min(heights_m[0], heights_m[-1]) - heights_m.min()
            worst = max(worst, dip_m / CARRY_DIP_M, (turned.max() - turned[-1]) / CARRY_TILT_RAD)
    return float(worst)


def _shifted(pose: Transform, shift_m: Array) -> Transform:
    shifted = np.array(pose)
    shifted[:3, 3] += shift_m
    return shifted


def _summary(failures: Sequence[_Infeasible], unreachable: str) -> _Infeasible:
    """The most frequent of the reasons why each configuration failed."""
    if not failures:
        return _Infeasible(Code.UNREACHABLE, unreachable)
    code, reason = Counter((f.code, f.reason) for f in failures).most_common(1)[0][0]
    return _Infeasible(code, reason)
