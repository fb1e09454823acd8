"""Pregrasps: arm configurations at the end of a free path, from which a straight tcp line down and up again is free.

Frames: docs/frames.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from bus.arrays import Joints, JointSamples, Transform
from bus.codes import Code
from bus.messages import Grasp
from bus.trajectory import Trajectory
from bus.transforms import from_rotation
from config.scene import floor_m
from config.schema import Station
from planning.arm import Arm
from planning.candidates import configurations, twins
from planning.infeasible import Infeasible, summary
from planning.line import tcp_line
from planning.motion import Allowed, Way, connect
from planning.obstacle import in_the_way
from planning.robot import Robot
from planning.scene import Scene, Width

Array = npt.NDArray[np.float64]
MadeT = TypeVar("MadeT")

LOWER_M = 0.05
"""Height above the place point from which the object is lowered, and to which the hand retreats."""
_ABOVE_FLOOR_M = 0.005
_HIGHER_M = 0.05
"""Step in which higher releases are tried, up to ``scene.place_higher_m``."""
_KEPT = 4
"""Number of pregrasps collected before a path around the obstacles is searched."""
_EVERY_TICKS = 4
_PLACE_YAWS_RAD = np.arange(12) * np.pi / 6


@dataclass(frozen=True)
class Pregrasp:
    """An arm configuration from which a tcp line is free.

    Attributes:
        q_rad: (joints,) end of the free path. ``line_rad``: the line (n, joints) from there.
        leave_rad: the line (m, joints) by which the hand leaves again.
    """

    q_rad: Joints
    line_rad: JointSamples
    leave_rad: JointSamples


def opening_m(grasp: Grasp, station: Station) -> float:
    """Return the opening of the hand on the approach line [m]."""
    return min(grasp.opening_m, station.hand.max_width_m)


def approach_begins(robot: Robot, reach: Trajectory, approach_m: float) -> int:
    """Return a tick of ``reach`` just before its straight approach line, which is ``approach_m`` long, begins.

    Until then the hand may be on its way to its opening; from there on it must be open.
    """
    commands = reach.filtered()
    end_m = robot.base_from_tcp(commands[-1])[:3, 3]
    for tick in range(len(commands) - 1, 0, -_EVERY_TICKS):
        if np.linalg.norm(robot.base_from_tcp(commands[tick])[:3, 3] - end_m) >= approach_m:
            return tick
    return 0


def pregrasps_of(
    scene: Scene, grasp: Grasp, base_from_tcp: Transform, q_now_rad: Joints
) -> Iterator[Pregrasp | Infeasible]:
    """Yield pregrasps before the grasp, with a free approach line and a free lift line, or the reason against one.

    Args:
        base_from_tcp: (4, 4) of the grasp.
        q_now_rad: (joints,) start; the cheapest configurations from there come first.
    """
    station = scene.station
    back_m = -station.planning.approach_m * base_from_tcp[:3, 2]
    up_m = np.array([0.0, 0.0, station.planning.lift_m])
    open_m = opening_m(grasp, station)
    befores = [shifted(pose, back_m) for pose in twins(base_from_tcp)]
    jammed: dict[int, Infeasible] = {}  # poses where the hand has no room, however the arm stands
    for q, before in configurations(scene.robot.arm, befores, q_now_rad):
        try:
            if id(before) in jammed:
                raise jammed[id(before)]
            _require_untouched("before the grasp", scene.on_the_way(), q, open_m)
            approach = _line(scene.robot.arm, "approach", q, before, -back_m)
            lift = _line(scene.robot.arm, "lift", approach[-1], shifted(before, -back_m), up_m)
            _require_free("approach", scene, approach, open_m)
            _require_free("lift", scene.empty(), lift, grasp.width_m)
        except Infeasible as why:
            if why.by_hand:
                jammed[id(before)] = why
            yield why
        else:
            yield Pregrasp(q, approach, lift)


def preplaces(
    holding: Scene, grasp: Grasp, base_from_tcp: Transform, view_q: Joints
) -> Iterator[Pregrasp | Infeasible]:
    """Yield pregrasps above the tray, with a free line down and up again, or the reason against one.

    Those above the first offset of ``scene.place_pattern_m`` come first, and the higher ones last.

    Args:
        base_from_tcp: (4, 4) of the grasp: the object keeps its tilt; its yaw is free, or ``scene.place_yaw_rad``. What
            hangs far below the hand is released higher than ``scene.place_m``, just above what is there.
        view_q: (joints,) start; the cheapest configurations from there come first.
    """
    scene = holding.station.scene
    for up_m in np.arange(0.0, scene.place_higher_m + 1e-6, _HIGHER_M):
        for x_m, y_m in scene.place_pattern_m:
            poses = _poses_above(base_from_tcp, holding.station, np.array([x_m, y_m, up_m]))
            yield from _above(holding, grasp, poses, view_q)


def _above(holding: Scene, grasp: Grasp, poses: Sequence[Transform], view_q: Joints) -> Iterator[Pregrasp | Infeasible]:
    down_m = np.array([0.0, 0.0, -LOWER_M])
    jammed: dict[int, Infeasible] = {}  # poses where what is held has no room, however the arm stands
    for q, pose in configurations(holding.robot.arm, poses, view_q):
        try:
            if id(pose) in jammed:
                raise jammed[id(pose)]
            _require_untouched("above the tray", holding, q, grasp.width_m)
            lower = _line(holding.robot.arm, "lower", q, pose, down_m)
            _require_free("lower", holding, lower, grasp.width_m)
            _require_free("retreat", holding.empty(), lower, None)  # it opens there
        except Infeasible as why:
            why.of_place = why.code is Code.COLLISION
            if why.by_hand:
                jammed[id(pose)] = why
            yield why
        else:
            yield Pregrasp(q, lower, lower[::-1])


def _poses_above(base_from_tcp: Transform, station: Station, offset_m: Array) -> list[Transform]:
    """Return the poses (4, 4) of the tcp from which the object is lowered to a point at an offset (3,) of the place."""
    above_m = np.add(_place_m(base_from_tcp, station, offset_m), (0.0, 0.0, LOWER_M))
    return [from_rotation(_turned(yaw) @ base_from_tcp[:3, :3], above_m) for yaw in _turns_rad(base_from_tcp, station)]


def _place_m(base_from_tcp: Transform, station: Station, offset_m: Array) -> Array:
    """Return where the tcp (3,) releases the object; it stood on the table when the tcp was at the grasp."""
    scene = station.scene
    hangs_m = float(base_from_tcp[2, 3]) - scene.table.top_m
    x, y, z = scene.place_m
    below_m = floor_m(scene, x + offset_m[0], y + offset_m[1])
    if below_m is not None:
        z = max(z, below_m + hangs_m + station.planning.clearance_m + _ABOVE_FLOOR_M)
    return np.add((x, y, z), offset_m)


def _turns_rad(base_from_tcp: Transform, station: Station) -> Array:
    """Return the turns about the vertical, from the grasp, in which the object may be laid down."""
    yaw_rad = station.scene.place_yaw_rad
    if yaw_rad is None:
        return _PLACE_YAWS_RAD
    closing = base_from_tcp[:3, 1]
    turn_rad = yaw_rad - float(np.arctan2(closing[1], closing[0]))
    return np.array([turn_rad, turn_rad + np.pi])  # a parallel hand has no front


def first_that_works(ways: Iterator[tuple[Way, Pregrasp]], make: Callable[[Way, Pregrasp], MadeT]) -> MadeT:
    """Return ``make(way, pregrasp)`` of the first pair for which it succeeds.

    Raises:
        Infeasible: none succeeds; with the most frequent reason.
    """
    failures: list[Infeasible] = []
    try:
        for way, pregrasp in ways:
            try:
                return make(way, pregrasp)
            except Infeasible as why:
                failures.append(why)
    except Infeasible as why:
        failures.append(why)
    raise summary(failures, "there is no way")


def ways(
    scene: Scene,
    q_from_rad: Joints,
    pregrasps: Iterator[Pregrasp | Infeasible],
    width_m: Width,
    calm: Callable[[Pregrasp], bool],
    allowed: Allowed | None = None,
    nothing: Infeasible | None = None,
) -> Iterator[tuple[Way, Pregrasp]]:
    """Yield straight paths to calm pregrasps; then a path around the obstacles to a calm one; then any path to any.

    Args:
        q_from_rad: (joints,) start.
        width_m: opening of the hand; None = any, it may move meanwhile.
        calm: whether the motion after a pregrasp keeps the held object level.
        allowed: a further condition for configurations of a searched path.
        nothing: what is raised where no arm configuration reaches any pregrasp.

    Raises:
        Infeasible: at the end, with the most frequent reason.
    """
    failures: list[Infeasible] = []
    kept: list[tuple[Pregrasp, bool]] = []
    for pregrasp in pregrasps:
        if isinstance(pregrasp, Infeasible):
            failures.append(pregrasp)
            continue
        kept.append((pregrasp, calm(pregrasp)))
        line = np.stack([q_from_rad, pregrasp.q_rad])
        if kept[-1][1] and scene.first_collision(line, width_m) is None:
            yield Way(0, "straight", line), pregrasp
        if len(kept) == _KEPT:
            break
    calm_ones, every = [one for one, is_calm in kept if is_calm], [one for one, _ in kept]
    for some in (calm_ones, every if len(every) > len(calm_ones) else []):
        if some:
            try:
                way = connect(scene, q_from_rad, [one.q_rad for one in some], width_m, allowed)
                yield way, some[way.goal]
            except Infeasible as why:
                failures.append(why)
    if not failures and nothing is not None:
        raise nothing
    raise summary(failures, "unreachable: no arm configuration reaches the pose")


def _line(arm: Arm, name: str, q_from_rad: Joints, base_from_tcp: Transform, shift_m: Array) -> JointSamples:
    line = tcp_line(arm, q_from_rad, base_from_tcp, shift_m)
    if line is None:
        raise Infeasible(Code.UNREACHABLE, f"{name}: the arm cannot follow the straight line")
    return line


def _require_untouched(name: str, scene: Scene, q_rad: Joints, width_m: Width) -> None:
    collision = scene.collision(q_rad, width_m)
    if collision is not None:
        raise in_the_way(name, collision, scene, width_m)


def _require_free(name: str, scene: Scene, points_rad: JointSamples, width_m: Width) -> None:
    collision = scene.first_collision(points_rad, width_m)
    if collision is not None:
        raise in_the_way(name, collision, scene, width_m, points_rad[-1])


def shifted(pose: Transform, shift_m: Array) -> Transform:
    """Return the pose (4, 4) moved by ``shift_m`` (3,) in its parent's frame."""
    return from_rotation(pose[:3, :3], pose[:3, 3] + shift_m)


def _turned(yaw_rad: float) -> Array:
    return np.array([[np.cos(yaw_rad), -np.sin(yaw_rad), 0.0], [np.sin(yaw_rad), np.cos(yaw_rad), 0.0], [0, 0, 1.0]])
