"""A day in numbers: the share of its picks that succeeded, and the picks of each hour."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from logs.comparison.intervals import rate
from logs.mcap.index import Entry

_ENDED = ("SUCCESS", "FAILED", "ABORTED")
_HOURS = 24


class Hour(NamedTuple):
    """The picks of one hour, UTC. ``height``: share [%] of the busiest hour; ``good``: share [%] that succeeded."""

    hour: int
    picks: int
    height: float
    good: float
    title: str


class Trend(NamedTuple):
    """The picks of a day.

    Attributes:
        success: in words, with its 95 % interval; "" without a pick.
        hours: from the first hour with a pick to the last one; none where all lie in one.
    """

    success: str
    hours: tuple[Hour, ...]


def trend(entries: Sequence[Entry]) -> Trend:
    """Return the trend of cycles. An attempt that was tried again is no pick, and neither is what found nothing."""
    picks = [entry for entry in entries if entry.result in _ENDED and not entry.retried_as]
    good = [entry for entry in picks if entry.result == "SUCCESS"]
    share = rate(len(good), len(picks))
    if share is None:
        return Trend("", ())
    value, low, high = (f"{100 * part:.0f} %" for part in share)
    interval = f"{value}, 95 % interval {low} to {high}"
    return Trend(f"{len(good)} of {len(picks)} picks succeeded: {interval}", _hours(picks, good))


def _hours(picks: Sequence[Entry], good: Sequence[Entry]) -> tuple[Hour, ...]:
    all_of, good_of = (Counter(hour for one in some if (hour := _hour(one)) is not None) for some in (picks, good))
    if len(all_of) < 2:
        return ()
    busiest = max(all_of.values())
    return tuple(
        Hour(
            hour,
            count := all_of[hour],
            100 * count / busiest,
            100 * good_of[hour] / count if count else 0.0,
            f"{hour:02d}:00 UTC: {good_of[hour]} of {count}",
        )
        for hour in range(min(all_of), max(all_of) + 1)
    )


def _hour(entry: Entry) -> int | None:
    """Of the cycle's start, from its id; None for an id of another kind."""
    digits = entry.cycle_id[9:11]
    return int(digits) if digits.isdecimal() and int(digits) < _HOURS else None
