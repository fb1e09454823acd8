"""The result of plan: the chosen grasp and every motion of the pick."""

from __future__ import annotations

from typing import Literal

from bus.frozen import Message
from bus.rejection import Rejection
from bus.trajectory import Trajectory

SegmentName = Literal["reach", "carry", "place", "home"]


class Segment(Message):
    """One executable motion of the pick, from rest to rest.

    Attributes:
        name: ``reach`` to the pregrasp and along the approach line, ``carry`` up the lift line and to the viewpoint of
            the second capture, ``place`` above the tray and down, ``home`` up and to the capture pose.
        route: whether its free part is a straight joint line, or was searched for around obstacles.
    """

    name: SegmentName
    route: Literal["straight", "searched"]
    trajectory: Trajectory


class PickPlan(Message):
    """plan: the chosen grasp and every motion of the pick, each checked against limits and collisions.

    Attributes:
        grasp: index of the chosen grasp. ``tilt_rad``: rotation of its approach about the closing axis (the rod).
    """

    grasp: int
    tilt_rad: float
    segments: tuple[Segment, ...]
    rejected: tuple[Rejection, ...]
