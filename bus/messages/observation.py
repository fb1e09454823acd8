"""A frame with the pose it was taken from."""

from __future__ import annotations

from bus.arrays import Transform
from bus.frozen import Message
from bus.messages.devices import ArmState, Frame


class View(Message):
    """The camera pose of one frame. The frame itself travels and is recorded as images, found by its stamp.

    Attributes:
        stamp_ns: of the frame, UTC.
        arm: the arm's state at the capture.
        base_from_color: (4, 4) pose of the colour camera in ``base`` [m].
    """

    stamp_ns: int
    arm: ArmState
    base_from_color: Transform


class Observation(Message):
    """capture: the frame and its camera pose. ``view.stamp_ns == frame.stamp_ns``."""

    view: View
    frame: Frame
