"""Plans one motion from rest to rest: find a path, round its corners, time it, and check its commands.

No other module of `planning` makes a `Trajectory` for an arm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bus.arrays import Joints, JointSamples
from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Segment, SegmentName
from bus.trajectory import Trajectory
from planning.blend import CORNER_SHARE, Curve, blended
from planning.calm import CalmTcp
from planning.infeasible import Infeasible
from planning.obstacle import in_the_way
from planning.scene import Scene, Width
from planning.search import search
from planning.slow_end import SlowEnd
from planning.timing import rest_to_rest, timed
from planning.world import Collision

_CORNER_SHARES = (CORNER_SHARE, 0.25, 0.1, 0.02)
"""Tried in this order: corners are cut less and less until the motion is free of collisions."""

_PATIENCE = 4
"""A move has only its one goal; a pick has other arm configurations and other grasps to try."""
HOLDING = frozenset[SegmentName]({"carry", "aside", "return", "place"})
"""Motions with the object in the hand."""
_STEP_RAD = 0.03
"""Distance at which a further condition is asked along a line."""

Allowed = Callable[[Joints], bool]


@dataclass(frozen=True)
class Way:
    """A free joint path to one of several goals.

    Attributes:
        goal: index of the goal. ``route``: how the path was found.
        points_rad: its vertices (n, joints), corners not yet rounded.
    """

    goal: int
    route: Literal["straight", "searched"]
    points_rad: JointSamples

    def lines(self) -> list[JointSamples]:
        """Return its straight joint lines, each (2, joints)."""
        return [self.points_rad[i : i + 2] for i in range(len(self.points_rad) - 1)]


def connect(
    scene: Scene,
    q_from_rad: Joints,
    goals_rad: Sequence[Joints],
    width_m: Width,
    allowed: Allowed | None = None,
    *,
    patience: int = 1,
) -> Way:
    """Return a free path to the first goal that a straight joint line reaches, else around obstacles to any of them.

    Args:
        q_from_rad: (joints,) start.
        goals_rad: goals, each (joints,), the preferred one first.
        width_m: opening of the hand; None = any, it may move meanwhile.
        allowed: a further condition for configurations of a searched path.
        patience: makes so many times `PlanningSettings.searches`.

    Raises:
        Infeasible: COLLISION, naming the obstacle.
    """
    collision: Collision | str = "no goal can be reached"
    for index, goal in enumerate(goals_rad):
        line = np.stack([q_from_rad, goal])
        blocked = scene.first_collision(line, width_m)
        if blocked is None:
            return Way(index, "straight", line)
        collision = blocked if index == 0 else collision

    def free_line(one: Joints, other: Joints) -> bool:
        is_allowed = allowed is None or all(allowed(q) for q in _along(one, other))
        return is_allowed and scene.is_line_free(one, other, width_m)

    for seed in range(patience * scene.station.planning.searches):
        path = search(scene.robot.arm.limits, free_line, q_from_rad, goals_rad, seed, lambda: scene.checks)
        if path is not None:
            way = _way_along(path, goals_rad)
            blocked = _bends_touch(blended(way.lines(), _CORNER_SHARES[-1]), scene, width_m)
            if blocked is None:
                return way
            collision = blocked
    raise in_the_way("no way around", collision, scene, width_m)


def _way_along(path_rad: JointSamples, goals_rad: Sequence[Joints]) -> Way:
    """Return the searched way along ``path_rad`` (n, joints), ending exactly at the goal that it reaches."""
    reached = int(np.argmin([np.abs(goal - path_rad[-1]).max() for goal in goals_rad]))
    return Way(reached, "searched", np.concatenate([path_rad[:-1], goals_rad[reached][None]]))


def _along(one: Joints, other: Joints) -> JointSamples:
    """Return configurations along a straight joint line, its ends included, 0.03 rad apart at most."""
    steps = int(np.ceil(float(np.linalg.norm(other - one)) / _STEP_RAD))
    return np.linspace(one, other, steps + 1)


def motion(
    name: SegmentName,
    way: Way,
    pieces: Sequence[JointSamples],
    scene: Scene,
    width_m: Width,
    *,
    leaving: Scene | None = None,
    slow_end: SlowEnd | None = None,
) -> Segment:
    """Return the motion along ``pieces``: the lines of ``way`` and the tcp lines before or after it, each of them free.

    Args:
        pieces: each (m, joints), beginning where the one before ends.
        width_m: opening of the hand; None = any, it may move meanwhile.
        leaving: the scene that applies on the first piece instead, until its corner.
        slow_end: a bound on the tcp's speed near the end.

    Raises:
        Infeasible: UNREACHABLE names the limit, COLLISION the pair that would touch.
    """
    collision: Collision | None = None
    for share in _CORNER_SHARES:
        curve = blended(pieces, share)
        collision = _bends_touch(curve, scene, width_m)
        if collision is None:
            trajectory = _timed(name, scene, curve, slow_end)
            collision = _gate(trajectory, curve, scene, leaving, width_m)
            if collision is None:
                return Segment(name=name, route=way.route, trajectory=trajectory)
    assert collision is not None, "no corner share is left out without one"
    raise in_the_way(name, collision, scene, width_m)


def move(scene: Scene, q_from_rad: Joints, q_to_rad: Joints) -> Trajectory:
    """Return a motion from rest to rest between two configurations (joints,), whatever the opening of the empty hand.

    It is a straight joint line, or else a path around the obstacles.

    Raises:
        CycleFailure: COLLISION, naming the obstacle; MOTION_REFUSED or UNREACHABLE outside the limits.
    """
    trajectory = rest_to_rest(scene.station, q_from_rad, q_to_rad)
    if scene.first_collision(trajectory.raw_q_rad, None) is None and scene.gate(trajectory.filtered(), None) is None:
        return trajectory
    for q_rad, which in ((q_from_rad, "cannot start"), (q_to_rad, "cannot end")):
        collision = scene.collision(q_rad, None)
        if collision is not None:
            raise CycleFailure(Code.COLLISION, f"The move {which} where it is told to: {collision}.")
    try:
        way = connect(scene, q_from_rad, [q_to_rad], None, patience=_PATIENCE)
        return motion("home", way, way.lines(), scene, None).trajectory
    except Infeasible as why:
        raise CycleFailure(why.code, f"There is no way from here: {why.reason}.") from why


def _bends_touch(curve: Curve, scene: Scene, width_m: Width) -> Collision | None:
    for begin, end in curve.bends:
        collision = scene.first_collision(curve.points_rad[begin : end + 1], width_m)
        if collision is not None:
            return collision
    return None


def _gate(
    trajectory: Trajectory, curve: Curve, scene: Scene, leaving: Scene | None, width_m: Width
) -> Collision | None:
    """Check the very commands that will be sent, with the scene's independent shapes."""
    commands = trajectory.filtered()
    if leaving is None:
        return scene.gate(commands, width_m)
    corner_q = curve.points_rad[curve.bends[0][0]] if curve.bends else curve.points_rad[-1]
    split = int(np.argmin(np.abs(commands - corner_q).max(axis=1)))
    return leaving.gate(commands[: split + 1], width_m) or scene.gate(commands[split:], width_m)


def _timed(name: SegmentName, scene: Scene, curve: Curve, slow_end: SlowEnd | None) -> Trajectory:
    most_m_s2 = scene.station.planning.max_held_acceleration_m_s2
    calm = [CalmTcp(scene.robot, curve, most_m_s2)] if name in HOLDING and most_m_s2 is not None else []
    try:
        return timed(scene.station, curve, *calm, slow_end=slow_end)
    except CycleFailure as why:
        raise Infeasible(Code.UNREACHABLE, f"{name}: limit: {why.text}") from why
