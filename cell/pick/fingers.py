"""Checks of the hand's reported width: possible, new, and as commanded."""

from __future__ import annotations

from bus.errors import HandFault
from bus.messages import HandState

_SLACK_M = 0.005
"""Tolerance of a measured width, relative to the hand's range and to the commanded width."""


def require_possible(state: HandState, widest_m: float) -> None:
    """Raises: HandFault for a width outside 0 to ``widest_m``."""
    if not -_SLACK_M <= state.width_m <= widest_m + _SLACK_M:  # written so that NaN fails
        raise HandFault(
            f"The hand reports a width of {state.width_m * 1e3:.1f} mm; it opens to {widest_m * 1e3:.0f} mm.",
            "Home it, or correct hand.max_width_m.",
        )


def is_at(state: HandState, commanded_m: float) -> bool:
    """Whether free fingers are at ``commanded_m``."""
    return abs(state.width_m - commanded_m) <= _SLACK_M  # NaN compares false


def require_at(state: HandState, commanded_m: float) -> None:
    """Raises: HandFault when free fingers are not at ``commanded_m``."""
    if not is_at(state, commanded_m):
        raise HandFault(
            f"The hand was told to open to {commanded_m * 1e3:.1f} mm and stands at {state.width_m * 1e3:.1f} mm.",
            "Is something between its fingers? Home it again.",
        )


def require_new(state: HandState, before: HandState) -> None:
    """Raises: HandFault when a hand that acted since reports the same state as ``before``."""
    if state.stamp_ns == before.stamp_ns:
        raise HandFault("The hand says the same as before it was told to act: it is stuck.", "Restart its node.")
