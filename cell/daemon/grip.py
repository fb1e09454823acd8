"""Judges what the hand may hold while nobody picks, by its last command and its measured width.

A stop leaves the fingers where they are, with their force. So whoever opens the hand next must know that something may
fall, and so must the person who looks at a cell that has stopped.
"""

from __future__ import annotations

import math

from bus.messages import HandState
from cell.pick.fingers import is_at
from config.devices import HandSettings
from drivers.interface import Hand

_WIDE_M = 0.002
"""Fingers that closed, and stand so near to wide open, were opened by somebody: no thing so wide fits between them."""


class Grip:
    """Whether the hand may hold something. The thread that moves the hand writes, any thread may read.

    Args:
        hand: its limits. ``least_m``: fingers that closed further hold nothing (``verify.min_width_m``).
    """

    def __init__(self, hand: HandSettings, least_m: float) -> None:
        self._hand, self._least_m = hand, least_m
        self._has_closed: bool | None = None  # None: nobody has moved the hand since the cell began
        self._came_m = math.inf  # width at which the fingers came to what they closed on

    def closes(self) -> None:
        """Say that the fingers are about to close on something."""
        self._has_closed = True

    def moved(self, state: HandState, commanded_m: float) -> None:
        """Say that free fingers were told to go to ``commanded_m``, and where they stand now."""
        if is_at(state, commanded_m):
            self._has_closed, self._came_m = False, commanded_m

    def homed(self, state: HandState) -> None:
        """Say that the hand was homed, which leaves it open unless it was stopped, and how it stands now."""
        self.moved(state, self._hand.max_width_m)

    def may_hold(self, width_m: float) -> bool:
        """Whether something may be between fingers that stand ``width_m`` apart."""
        if self._has_closed is False or not width_m >= self._least_m:  # written so that NaN holds nothing
            return False
        if self._has_closed is None:
            return width_m < self._hand.max_width_m - self._hand.release_margin_m
        return width_m < self._hand.max_width_m - _WIDE_M

    def let_go_m(self, width_m: float) -> float | None:
        """Return the width [m] at which fingers ``width_m`` apart let go of what they may hold; None = of nothing.

        They open as wide as they came, where there was room for them, and the release margin wider than they stand;
        all the way when nobody knows how they came.
        """
        if not self.may_hold(width_m):
            return None
        return min(self._hand.max_width_m, max(self._came_m, width_m + self._hand.release_margin_m))


class GripHand:
    """The cell's hand, which tells its `Grip` what it does."""

    def __init__(self, hand: Hand, grip: Grip) -> None:
        self._hand, self._grip = hand, grip

    def connect(self) -> None:
        """As `Hand.connect`."""
        self._hand.connect()

    def state(self) -> HandState:
        """As `Hand.state`."""
        return self._hand.state()

    def move(self, width_m: float, speed_m_s: float) -> HandState:
        """As `Hand.move`."""
        state = self._hand.move(width_m, speed_m_s)
        self._grip.moved(state, width_m)
        return state

    def grasp(self, force_n: float, speed_m_s: float) -> HandState:
        """As `Hand.grasp`."""
        self._grip.closes()
        return self._hand.grasp(force_n, speed_m_s)

    def home(self) -> HandState:
        """As `Hand.home`."""
        state = self._hand.home()
        self._grip.homed(state)
        return state

    def stop(self) -> None:
        """As `Hand.stop`."""
        self._hand.stop()

    def close(self) -> None:
        """As `Hand.close`."""
        self._hand.close()
