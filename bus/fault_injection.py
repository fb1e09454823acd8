"""The kinds of injected fault, the parts that accept them, and the request that sets one."""

from __future__ import annotations

from enum import StrEnum
from typing import Literal, get_args

from bus.frozen import Message


class Fault(StrEnum):
    """The way in which a part misbehaves."""

    NONE = "none"
    """No fault."""
    OFF = "off"
    """The part is gone and answers nothing."""
    STUCK = "stuck"
    """The part is present, but requests have no effect and get no answer."""
    GARBAGE = "garbage"
    """Impossible values, e.g. random bytes or NaN."""
    WRONG = "wrong"
    """Plausible but wrong values."""
    SLOW = "slow"
    """Correct behaviour, but every answer comes late."""


Part = Literal["camera", "arm", "hand", "model", "bus", "disk"]
PARTS: tuple[Part, ...] = get_args(Part)
"""The parts that accept faults: three devices, the goal-image model, a node's link, and the recordings' disk."""


class FaultRequest(Message):
    """Sets the fault of a part.

    Attributes:
        fault: how the part misbehaves from now on.
        delay_s: of every answer under ``slow``; None = unchanged.
    """

    fault: Fault
    delay_s: float | None = None
