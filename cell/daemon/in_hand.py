"""Tells a person that something may be in the hand of a cell that has stopped, and what to do about it.

It is made anew of the newest width that the hand says, so it goes when the thing does.
"""

from __future__ import annotations

from bus import topics
from bus.codec import decode
from bus.errors import BadPayload
from bus.messages import HandState
from bus.sample import Sample
from cell.daemon.grip import Grip
from cell.daemon.publisher import Publisher
from cell.machine.states import ENDED, State

_ADVICE = (
    "A reset opens the hand there and then, before the arm moves. To take it out first: mode Manual, and open the hand"
    " over a place, or while you hold the thing."
)
_SAME_M = 0.003
"""By so much the width may change without that it is said again."""


class InHand:
    """Tells what may be in the hand: in the state's reason, and in one event each time that the cell comes to rest.

    Args:
        publisher: publishes it. It asks for `tell`.
    """

    def __init__(self, grip: Grip, publisher: Publisher) -> None:
        self._grip, self._publisher, self._payload = grip, publisher, b""
        self._said_m: float | None = None  # the width that was said last; None = nothing in the hand
        self._has_told = False

    def hear(self, sample: Sample) -> None:
        """Take the newest state of the hand; any thread may call it, and nothing is read yet."""
        if sample.key == topics.HAND_STATE.key:
            self._payload = sample.payload  # replaced as a whole

    def look(self, state: State) -> None:
        """Say what has changed; called by the machine's owner thread."""
        if state not in ENDED:
            self._has_told = False
            return
        self._publisher.publish_in_hand()
        if self._said_m is not None and not self._has_told:
            self._has_told = True
            self._publisher.publish_event("HAND_NOT_EMPTY", "warning", self._text, _ADVICE)

    def tell(self) -> str:
        """That something may be in the hand, and what to do; "" when nothing is, or its state is not known."""
        width_m = self._width_m()
        if width_m is None or self._said_m is None or abs(width_m - self._said_m) > _SAME_M:
            self._said_m = width_m
        return f"{self._text} {_ADVICE}" if self._said_m is not None else ""

    @property
    def _text(self) -> str:
        width_m = self._said_m or 0.0
        return f"Something may be in the hand: its fingers are {width_m * 1e3:.0f} mm apart."

    def _width_m(self) -> float | None:
        payload = self._payload
        if not payload:
            return None
        try:
            hand = decode(HandState, payload)
        except BadPayload:  # `cell.nodes.health` reports it
            return None
        if hand.is_moving:
            return self._said_m  # what lies between fingers is known when they rest
        return hand.width_m if self._grip.may_hold(hand.width_m) else None
