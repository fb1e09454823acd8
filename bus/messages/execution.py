"""The results of execute, deliver and verify."""

from __future__ import annotations

from typing import Literal

from bus.arrays import Transform
from bus.codes import Code
from bus.frozen import Message
from bus.messages.devices import HandState, Motion
from bus.messages.observation import View
from bus.messages.plan import SegmentName

Witness = Literal["load", "width", "place", "seam"]
"""The measurement that tells that more than one thing was picked."""


class SegmentRun(Message):
    """A segment as it was executed.

    Attributes:
        name: of the segment; ``hold``: standing still; ``retreat``: back up after a contact.
        motion: what was commanded and measured.
        hand: the hand's state after it. ``hand_meanwhile``: its states while the object is carried, in order.
    """

    name: SegmentName | Literal["hold", "retreat"]
    motion: Motion
    hand: HandState
    hand_meanwhile: tuple[HandState, ...] = ()


class Contact(Message):
    """The contact of the arm with something on its approach line, short of the grasp.

    Attributes:
        base_from_tcp: (4, 4) where it came to rest.
        force_n: against its motion, more than when the line began, when it braked.
        remaining_m: from there to the grasp. ``closes_within_m``: where the fingers still close, it is no more.
    """

    base_from_tcp: Transform
    force_n: float
    remaining_m: float
    closes_within_m: float

    @property
    def in_words(self) -> str:
        """The force that it met and where, as the beginning of a sentence."""
        return f"The arm met {self.force_n:.1f} N {self.remaining_m * 1e3:.1f} mm before the grasp"


class Execution(Message):
    """execute: commanded and measured motion, from the start to the end of the hold, and the second capture.

    Attributes:
        runs: the segments in the order they ran, ``hold`` ones included, each with the hand's state after it.
        grasped: the hand's state right after closing; None if it never closed.
        stopped_in: the segment (or hand action) that a stop interrupted or prevented, or None.
        after: the second capture, taken while holding; None if not reached, or if width and load were enough.
        began: the hand's state before all of it; None in recordings of before it was kept.
        contact: what the arm met on its way down; then the fingers closed where it rested, or they did not and it went
            back (``retreat``). None = nothing.
    """

    runs: tuple[SegmentRun, ...]
    grasped: HandState | None
    stopped_in: str | None
    after: View | None
    began: HandState | None = None
    contact: Contact | None = None


class Delivery(Message):
    """deliver: the motions after the verdict: the held object laid into the tray, the arm back home.

    Attributes:
        runs: the segments in the order they ran.
        released: the hand's state after opening; None if not reached.
    """

    runs: tuple[SegmentRun, ...]
    released: HandState | None


class Verdict(Message):
    """verify: whether the object was picked, and the measurements behind it.

    Attributes:
        reason: the answer in words, with what was measured.
        held: the answer. ``code``: None when held.
        hold_s: how long the hold was observed; ``width_min_m``: smallest hand width meanwhile, and on the way there.
        load_n: mean vertical force of the load on the tcp during the hold, relative to just before the grasp.
        carried_n: the same over the way there, lift included; None in recordings of before it was measured.
        cleared_fraction: share of the object's place that the second capture shows empty, or lower than it was; None =
            it sees less than a quarter of it, or there was none.
        several_by: what told that more than one thing was picked. ``also_gone``: the numbers of the other things whose
            places are empty, too.
    """

    held: bool
    code: Code | None
    reason: str
    hold_s: float
    width_min_m: float
    load_n: float
    cleared_fraction: float | None
    carried_n: float | None = None
    several_by: tuple[Witness, ...] = ()
    also_gone: tuple[int, ...] = ()
