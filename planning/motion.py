"""One motion from rest to rest: find its way, round its corners, time it, and judge the commands before they leave.

Nothing else in `planning` makes a `Trajectory` that an arm will play.
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
from planning.infeasible import Infeasible
from planning.scene import Scene
from planning.search import search
from planning.timing import rest_to_rest, timed
from planning.world import Collision

_CORNER_SHARES = (CORNER_SHARE, 0.25, 0.1, 0.02)
"""Corners are cut less and less until nothing is touched."""

Allowed = Callable[[Joints], bool]


@dataclass(frozen=True)
class Way:
    """A free joint path to one of several goals.

    Attributes:
        goal: which. ``route``: how it was found. ``points_rad``: its vertices (n, 7), corners not yet rounded.
    """

    goal: int
    route: Literal["straight", "searched"]
    points_rad: JointSamples

    def lines(self) -> list[JointSamples]:
        """Its straight joint lines."""
        return [self.points_rad[i : i + 2] for i in range(len(self.points_rad) - 1)]


def connect(
    scene: Scene, q_from_rad: Joints, goals_rad: Sequence[Joints], width_m: float, allowed: Allowed | None = None
) -> Way:
    """A free way to the first goal that a straight joint line reaches, else to any of them around the obstacles.

    Args:
        width_m: opening of the hand.
        allowed: what else a searched path must keep to.

    Raises: Infeasible, naming what is in the way.
    """
    collision: Collision | str = "no goal can be reached"
    for index, goal in enumerate(goals_rad):
        line = np.stack([q_from_rad, goal])
        blocked = scene.first_collision(line, width_m)
        if blocked is None:
            return Way(index, "straight", line)
        collision = blocked if index == 0 else collision

    def free(q: Joints) -> bool:
        return (allowed is None or allowed(q)) and scene.collision(q, width_m) is None

    for seed in range(scene.station.planning.searches):
        path = search(free, q_from_rad, goals_rad, seed)
        if path is not None and scene.first_collision(path, width_m) is None:
            reached = int(np.argmin([np.abs(goal - path[-1]).max() for goal in goals_rad]))
            return Way(reached, "searched", np.concatenate([path[:-1], goals_rad[reached][None]]))
    raise Infeasible(Code.COLLISION, f"no way around: {collision}")


def motion(
    name: SegmentName,
    way: Way,
    pieces: Sequence[JointSamples],
    scene: Scene,
    width_m: float,
    *,
    leaving: Scene | None = None,
) -> Segment:
    """The motion along ``pieces``, which hold ``way`` and the tcp lines before or after it, each of them free.

    Args:
        leaving: the scene that counts instead on the first piece, until its corner.

    Raises: Infeasible: a limit, or what would be touched.
    """
    collision: Collision | None = None
    for share in _CORNER_SHARES:
        curve = blended(pieces, share)
        collision = _bends_touch(curve, scene, width_m)
        if collision is None:
            trajectory = _timed(name, scene, curve)
            collision = _gate(trajectory, curve, scene, leaving, width_m)
            if collision is None:
                return Segment(name=name, route=way.route, trajectory=trajectory)
    raise Infeasible(Code.COLLISION, f"{name}: {collision}")


def move(scene: Scene, q_from_rad: Joints, q_to_rad: Joints) -> Trajectory:
    """From rest to rest with the hand as wide as it may be: a straight joint line, or else around what is in the way.

    Raises: CycleFailure: COLLISION, naming what is touched; MOTION_REFUSED outside the limits.
    """
    width_m = scene.station.hand.max_width_m
    trajectory = rest_to_rest(scene.station, q_from_rad, q_to_rad)
    if (
        scene.gate(trajectory.filtered(), width_m) is None
        and scene.first_collision(trajectory.raw_q_rad, width_m) is None
    ):
        return trajectory
    for q_rad, which in ((q_from_rad, "cannot start"), (q_to_rad, "cannot end")):
        collision = scene.collision(q_rad, width_m)
        if collision is not None:
            raise CycleFailure(Code.COLLISION, f"The move {which} where it is told to: {collision}.")
    try:
        way = connect(scene, q_from_rad, [q_to_rad], width_m)
        return motion("home", way, way.lines(), scene, width_m).trajectory
    except Infeasible as why:
        raise CycleFailure(why.code, f"There is no way from here: {why.reason}.") from why


def _bends_touch(curve: Curve, scene: Scene, width_m: float) -> Collision | None:
    for begin, end in curve.bends:
        collision = scene.first_collision(curve.points_rad[begin : end + 1], width_m)
        if collision is not None:
            return collision
    return None


def _gate(
    trajectory: Trajectory, curve: Curve, scene: Scene, leaving: Scene | None, width_m: float
) -> Collision | None:
    """The independent judgement of the very commands that will be sent."""
    commands = trajectory.filtered()
    if leaving is None:
        return scene.gate(commands, width_m)
    corner_q = curve.points_rad[curve.bends[0][0]] if curve.bends else curve.points_rad[-1]
    split = int(np.argmin(np.abs(commands - corner_q).max(axis=1)))
    return leaving.gate(commands[: split + 1], width_m) or scene.gate(commands[split:], width_m)


def _timed(name: SegmentName, scene: Scene, curve: Curve) -> Trajectory:
    try:
        return timed(scene.station, curve)
    except CycleFailure as why:
        raise Infeasible(Code.UNREACHABLE, f"{name}: limit: {why.text}") from why
