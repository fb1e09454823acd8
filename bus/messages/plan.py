"""The result of plan: the chosen grasp and every motion of the pick."""

from __future__ import annotations

from typing import Literal

from bus.frozen import Message
from bus.rejection import Rejection
from bus.trajectory import Trajectory

SegmentName = Literal["reach", "carry", "place", "home", "aside", "return"]
ONLY_TO_LOOK: frozenset[SegmentName] = frozenset({"aside", "return"})
"""Segments that are played only when the place is looked at."""


class Segment(Message):
    """One executable motion of the pick, from rest to rest.

    Attributes:
        trajectory: joint positions over time.
        name: ``reach`` to the pregrasp and along the approach line, ``carry`` up the lift line and to where the object
            is held, ``place`` down into the tray, ``home`` up and to the capture pose. The object is held at the
            viewpoint of the second capture, from which ``place`` first goes above the tray; or above the tray, from
            which ``aside`` goes to the viewpoint and ``return`` back, if the place must be looked at.
        route: whether its free part is a straight joint line, or was searched for around obstacles.
    """

    name: SegmentName
    route: Literal["straight", "searched"]
    trajectory: Trajectory


class PickPlan(Message):
    """plan: the chosen grasp and every motion of the pick, each checked against limits and collisions.

    Attributes:
        segments: in the order in which they are played.
        rejected: the better grasps that are not feasible, and why.
        grasp: index of the chosen grasp. ``tilt_rad``: rotation of its approach about the closing axis (the rod).
    """

    grasp: int
    tilt_rad: float
    segments: tuple[Segment, ...]
    rejected: tuple[Rejection, ...]
