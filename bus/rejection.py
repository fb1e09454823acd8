"""The reason why planning rejected a grasp, and what was in its way."""

from __future__ import annotations

from typing import Literal

from bus.arrays import Points, Transform, Vector3
from bus.codes import Code
from bus.frozen import Message

ObstacleKind = Literal["box", "seen", "unseen", "target", "robot"]


class Obstacle(Message):
    """The thing in the way, where the arm would have come nearest to it.

    Attributes:
        part: of the robot, e.g. ``left finger``; ``held object``: what it carries.
        name: what the part would touch, e.g. ``table``.
        kind: a ``box`` of the station file, something ``seen`` or the ``unseen`` space behind it, the ``target``, or
            another part of the ``robot``.
        too_near_m: the shortest way, level or up, by which the part would have to move for enough room; None = longer
            than 60 mm.
        needed_m: the smallest distance allowed between the two.
        touch_m: (3,) the place in ``base`` of the obstacle that is nearest to the part.
        base_from_tcp: (4, 4) the hand there. ``opening_m``: of the hand; None = it may be any.
        points_m: (n, 3) in ``base``: the corners of a box, else some of the points that it was seen by.
    """

    part: str
    name: str
    kind: ObstacleKind
    too_near_m: float | None
    needed_m: float
    touch_m: Vector3
    base_from_tcp: Transform
    opening_m: float | None
    points_m: Points


class Rejection(Message):
    """A way to grasp that was rejected, and why.

    Attributes:
        grasp: its index among the grasps.
        code: the kind of obstacle. ``reason``: which, with its measurements.
        tilt_rad: as in `PickPlan`.
        obstacle: of a collision, when no other way was feasible either; else None, as in older recordings.
    """

    grasp: int
    tilt_rad: float
    code: Code
    reason: str
    obstacle: Obstacle | None = None
