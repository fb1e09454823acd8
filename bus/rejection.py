"""The reason why planning rejected a grasp."""

from __future__ import annotations

from bus.codes import Code
from bus.frozen import Message


class Rejection(Message):
    """A way to grasp that was rejected, and why. ``tilt_rad``: as in `PickPlan`."""

    grasp: int
    tilt_rad: float
    code: Code
    reason: str
