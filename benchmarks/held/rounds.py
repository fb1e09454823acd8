"""One pick as it truly was: what rose with the hand, what the cell said, and where its time went."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from benchmarks.heaps.heap import Heap
from benchmarks.held.watched import ARM, CAPTURE, GRASP, HAND, HOLD, PRESENT, Deed
from bus.messages import CycleResult

RISEN_M = 0.05
"""An object whose centre of mass is so much higher at the end of the hold than before the pick is held."""
_HANDS = (HAND, GRASP)
_MOVES = (ARM, HOLD, *_HANDS)


@dataclass(frozen=True)
class Times:
    """Seconds of one cycle, from its object's presentation until the next may begin.

    Attributes:
        motion, hand, hold: simulated, in which the arm moves; only the hand does; the arm stands still with the object.
        capture: wall time in which only the camera is busy.
        compute_not_hidden: wall time in which no device is, except of ``log``.
        log: wall time from the end of the last stage until the result is said: the recording is closed.
        simulated: of all devices. ``wall``: of the whole cycle.
    """

    motion: float
    hand: float
    hold: float
    capture: float
    compute_not_hidden: float
    log: float
    simulated: float
    wall: float


@dataclass(frozen=True)
class Attempt:
    """One cycle.

    Attributes:
        is_executed: whether it came to its hold.
        risen: the bodies that were risen at the end of the hold. ``carried``: those of them that the
            hand still held before it opened over the tray.
    """

    result: CycleResult
    is_executed: bool
    risen: tuple[int, ...]
    carried: tuple[int, ...]
    times: Times

    @property
    def is_presented(self) -> bool:
        """Whether there was an object to pick."""
        return bool(self.result.stages)


@dataclass
class Pick:
    """All attempts at one object, or at one of a heap.

    Attributes:
        name: of the presented object; of a heap, of what truly rose, else "".
        scene: what lay there before the first attempt.
        feasible: whether it was held, or the oracle finds a grasp; None = not asked yet.
    """

    name: str
    seed: int
    attempts: list[Attempt]
    scene: Heap | None
    feasible: bool | None = None

    @property
    def last(self) -> Attempt:
        """The attempt whose verdict counts."""
        return self.attempts[-1]

    @property
    def is_held(self) -> bool:
        """Whether something truly rose in any attempt."""
        return any(one.risen for one in self.attempts)

    @property
    def is_success(self) -> bool:
        """Whether the cell says that it succeeded."""
        return self.last.result.result == "SUCCESS"


@dataclass
class Window:
    """One cycle as it was heard, by the monotonic clock [s]."""

    began_s: float
    staged_s: float = 0.0
    said_s: float = 0.0
    ended_s: float = 0.0
    result: CycleResult | None = None
    deeds: list[Deed] = field(default_factory=list)


def attempt_of(window: Window) -> Attempt:
    """Return what became of a cycle that has ended."""
    assert window.result is not None
    deeds = sorted(window.deeds, key=lambda deed: deed.began_s)
    presented = [deed for deed in deeds if deed.kind == PRESENT]
    if presented:
        deeds = [deed for deed in deeds if deed.began_s >= presented[-1].ended_s]
    lifted = _with_closed_hand(deeds)
    held = next((deed for deed in reversed(lifted) if deed.kind == HOLD), None)
    before = next((deed for deed in deeds if deed.kind == CAPTURE), None)
    risen = _risen(before, held)
    carried = tuple(body for body in risen if lifted[-1].touching[body])
    began_s = presented[-1].ended_s if presented else window.began_s
    return Attempt(window.result, held is not None, risen, carried, _times(deeds, began_s, window))


def seen_first(window: Window) -> Deed | None:
    """Return the cycle's first capture: where everything was before it."""
    return next((deed for deed in sorted(window.deeds, key=lambda deed: deed.began_s) if deed.kind == CAPTURE), None)


def _with_closed_hand(deeds: Sequence[Deed]) -> Sequence[Deed]:
    """Return what is done after the grasp, before the hand opens again."""
    grasped = next((index for index, deed in enumerate(deeds) if deed.kind == GRASP), len(deeds))
    after = deeds[grasped + 1 :]
    return after[: next((index for index, deed in enumerate(after) if deed.kind in _HANDS), len(after))]


def _risen(before: Deed | None, then: Deed | None) -> tuple[int, ...]:
    if before is None or then is None:
        return ()
    return tuple(int(body) for body in (then.height_m - before.height_m > RISEN_M).nonzero()[0])


def _times(deeds: Sequence[Deed], began_s: float, window: Window) -> Times:
    def simulated(*kinds: str) -> float:
        return _covered((deed.from_s, deed.to_s) for deed in deeds if deed.kind in kinds)

    def wall(*kinds: str) -> float:
        return _covered((deed.began_s, deed.ended_s) for deed in deeds if deed.kind in kinds)

    arm, moves = simulated(ARM, HOLD), simulated(*_MOVES)
    log_s = max(0.0, window.said_s - window.staged_s)
    whole_s = window.ended_s - began_s
    return Times(
        motion=simulated(ARM),
        hand=moves - arm,
        hold=arm - simulated(ARM),
        capture=wall(CAPTURE, *_MOVES) - wall(*_MOVES),
        compute_not_hidden=max(0.0, whole_s - wall(CAPTURE, *_MOVES) - log_s),
        log=log_s,
        simulated=moves,
        wall=whole_s,
    )


def _covered(spans: Iterable[tuple[float, float]]) -> float:
    """The length of the union."""
    total, until = 0.0, float("-inf")
    for began, ended in sorted(spans):
        total += max(0.0, ended - max(began, until))
        until = max(until, ended)
    return total
