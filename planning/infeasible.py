"""The error of one way to grasp that is not feasible, while another may be."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

from bus.codes import Code
from bus.rejection import Obstacle


class Infeasible(Exception):
    """One way to grasp is not feasible. ``code`` and ``reason`` go into the log.

    Attributes:
        by_hand: every other arm configuration with the same hand pose fails too.
        of_place: it is the place that is out of reach, or taken, whatever the grasp.
        obstacle: finds out what was in the way, and how near; asked only of what is reported.
    """

    def __init__(
        self,
        code: Code,
        reason: str,
        *,
        by_hand: bool = False,
        of_place: bool = False,
        obstacle: Callable[[], Obstacle | None] = lambda: None,
    ) -> None:
        super().__init__(reason)
        self.code = code
        self.reason = reason
        self.by_hand = by_hand
        self.of_place = of_place
        self.obstacle = obstacle


def summary(failures: Sequence[Infeasible], nothing: str) -> Infeasible:
    """Return the most frequent of the failures; collisions count before unreachable poses, since they tell more.

    Args:
        nothing: the reason when there are no failures.
    """
    collisions = [f for f in failures if f.code is Code.COLLISION]
    if not failures:
        return Infeasible(Code.UNREACHABLE, nothing)
    code, reason = Counter((f.code, f.reason) for f in collisions or failures).most_common(1)[0][0]
    first = next(f for f in failures if (f.code, f.reason) == (code, reason))
    return Infeasible(code, reason, of_place=first.of_place, obstacle=first.obstacle)
