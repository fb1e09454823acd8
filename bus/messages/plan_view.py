"""A plan as a picture in 3-D: the robot on its way, and what stands around it. Frames: docs/frames.md."""

from __future__ import annotations

from bus.arrays import JointSamples, PointColors, Points, PoseSamples, Samples, Triangles, Vector3
from bus.frozen import Message
from bus.messages.approval import Proposal
from bus.messages.plan import SegmentName


class PlannedPath(Message):
    """One segment of a plan, sampled for the eye.

    Attributes:
        name: of the segment, as in `Segment`.
        only_to_look: played only when the place is looked at.
        width_m: opening of the hand meanwhile.
        nearest_m: the shortest distance from each known box, by its name; negative inside of a part's convex hull.
        times_s: (n,) from its begin. ``q_rad``: (m, n). ``tcp_m``: (n, 3) in ``base``.
        base_from_frame: (n, f, 3, 4) the upper three rows of the pose of every frame of `PlanView`.
    """

    name: SegmentName
    only_to_look: bool
    width_m: float
    nearest_m: dict[str, float]
    times_s: Samples
    q_rad: JointSamples
    tcp_m: Points
    base_from_frame: PoseSamples


class Outline(Message):
    """The simplified convex hull of one part of the robot.

    Attributes:
        name: of the part.
        frame: index of the frame that it moves with.
        vertices_m: (v, 3) in that frame. ``faces``: (t, 3) triangles of them, counter-clockwise from outside.
    """

    name: str
    frame: int
    vertices_m: Points
    faces: Triangles


class NamedBox(Message):
    """A known box of the scene, its sides along the axes of ``base``.

    Attributes:
        name: of the station file.
        center_m: (3,) its middle in ``base``. ``size_m``: (3,) its edges along x, y and z.
    """

    name: str
    center_m: Vector3
    size_m: Vector3


class PlanView(Message):
    """The last plan, in ``base``.

    Attributes:
        proposal: what the plan proposes.
        is_open: it waits for somebody's answer now.
        frames: names of the robot's frames. ``parts``: its parts in them.
        segments: in the order in which they are played.
        boxes: the known ones; the first is the table.
        cloud_m: (c, 3) what was seen, thinned out. ``cloud_rgb``: (c, 3) its colours.
    """

    proposal: Proposal
    is_open: bool
    frames: tuple[str, ...]
    parts: tuple[Outline, ...]
    segments: tuple[PlannedPath, ...]
    boxes: tuple[NamedBox, ...]
    cloud_m: Points
    cloud_rgb: PointColors
