"""Why one way to do it does not work, while another may."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from bus.codes import Code


class Infeasible(Exception):
    """One way to do it does not work. ``code`` and ``reason`` go into the log.

    Attributes:
        by_hand: nor does any other way that brings the hand there.
    """

    def __init__(self, code: Code, reason: str, *, by_hand: bool = False) -> None:
        super().__init__(reason)
        self.code = code
        self.reason = reason
        self.by_hand = by_hand


def summary(failures: Sequence[Infeasible], nothing: str) -> Infeasible:
    """The most frequent of the reasons; what collides tells more than what cannot be reached."""
    collisions = [f for f in failures if f.code is Code.COLLISION]
    if not failures:
        return Infeasible(Code.UNREACHABLE, nothing)
    code, reason = Counter((f.code, f.reason) for f in collisions or failures).most_common(1)[0][0]
    return Infeasible(code, reason)
