"""The words for how a part of the cell misbehaves on demand, and the request that sets one."""

from __future__ import annotations

import threading
from enum import StrEnum
from typing import Literal, get_args

from bus.frozen import Message


class Fault(StrEnum):
    """How a part misbehaves."""

    NONE = "none"
    """Not at all."""
    OFF = "off"
    """It is not there: nothing is answered any more."""
    STUCK = "stuck"
    """It is there, and nothing comes of what is asked."""
    GARBAGE = "garbage"
    """What it gives cannot be."""
    WRONG = "wrong"
    """What it gives could be, and is not so."""
    SLOW = "slow"
    """It does everything as it should; each answer comes late."""


Part = Literal["camera", "arm", "hand", "model", "bus", "disk"]
PARTS: tuple[Part, ...] = get_args(Part)
"""What can be spoiled: the three devices, the goal-image model, a node's link, and where recordings are written."""


class FaultRequest(Message):
    """What a part is to do from now on. ``delay_s``: how late a slow one is; None = as it was."""

    fault: Fault
    delay_s: float | None = None


class Faulty:
    """What can be spoiled at any time, from any thread: ``fault`` is how, ``delay_s`` how late when slow.

    Whoever waits for another fault waits on ``_turn``.
    """

    def __init__(self, fault: Fault, delay_s: float) -> None:
        self._fault = fault
        self._turn = threading.Condition()
        self.delay_s = delay_s

    @property
    def fault(self) -> Fault:
        return self._fault

    @fault.setter
    def fault(self, fault: Fault) -> None:
        with self._turn:
            self._fault = Fault(fault)
            self._turn.notify_all()
        self._on_fault(fault)

    def _on_fault(self, fault: Fault) -> None:
        """What a part does by itself with a new fault."""
