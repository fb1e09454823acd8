"""The results of execute, deliver and verify."""

from __future__ import annotations

from typing import Literal

from bus.codes import Code
from bus.frozen import Message
from bus.messages.devices import HandState, Motion
from bus.messages.observation import View
from bus.messages.plan import SegmentName


class SegmentRun(Message):
    """A segment as it was executed.

    Attributes:
        hand: the hand's state after it.
    """

    name: SegmentName | Literal["hold"]
    motion: Motion
    hand: HandState


class Execution(Message):
    """execute: commanded and measured motion, from the start to the end of the hold, and the second capture.

    Attributes:
        runs: the segments in the order they ran, ``hold`` ones included, each with the hand's state after it.
        grasped: the hand's state right after closing; None if it never closed.
        stopped_in: the segment (or hand action) that a stop interrupted or prevented, or None.
        after: the second capture, taken while holding; None if not reached.
    """

    runs: tuple[SegmentRun, ...]
    grasped: HandState | None
    stopped_in: str | None
    after: View | None


class Delivery(Message):
    """deliver: the motions after the verdict: the held object laid into the tray, the arm back home.

    Attributes:
        released: the hand's state after opening; None if not reached.
    """

    runs: tuple[SegmentRun, ...]
    released: HandState | None


class Verdict(Message):
    """verify: whether the object was picked, and the measurements behind it.

    Attributes:
        held: the answer. ``code``: None when held.
        hold_s: how long the hold was observed; ``width_min_m``: smallest hand width meanwhile.
        load_n: mean vertical force of the load on the tcp during the hold, relative to just before the grasp.
        cleared_fraction: share of the object's observed height map that the second capture shows empty.
    """

    held: bool
    code: Code | None
    reason: str
    hold_s: float
    width_min_m: float
    load_n: float
    cleared_fraction: float
