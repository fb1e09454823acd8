"""Compares two folders of recordings: is the new version better? Rates by code and object, with 95 % intervals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import NamedTuple

from bus.codec import Json
from logs.catalogue import Catalogue, open_catalogue
from logs.catalogue.opening import Tell
from logs.catalogue.update import Progress, quietly
from logs.comparison.intervals import Interval, median_difference, picks_needed, rate, rate_difference

_TIMES = ("wall_s", "detect_s", "plan_s", "execute_s")


class Pick(NamedTuple):
    """The last attempt of one pick; times [s], None where the cycle did not come so far."""

    object: str
    result: str
    code: str
    executed: int | None
    held: int | None
    station_hash: str
    commit_id: str
    wall_s: float | None
    detect_s: float | None
    plan_s: float | None
    execute_s: float | None


@dataclass(frozen=True)
class Rate:
    """One rate on both sides: how often, of how many; ``difference`` is B - A."""

    name: str
    a: tuple[int, int]
    b: tuple[int, int]

    @property
    def rate_a(self) -> Interval | None:
        """Of A, with Wilson's interval; None of nothing."""
        return rate(*self.a)

    @property
    def rate_b(self) -> Interval | None:
        """Of B."""
        return rate(*self.b)

    @property
    def difference(self) -> Interval | None:
        """B - A, with Newcombe's interval; None where a side has nothing."""
        return rate_difference(self.rate_a, self.rate_b)

    def to_json(self) -> Json:
        """Return the counts, rates and bounds as a JSON object."""
        return {
            "name": self.name,
            "a": _json(self.rate_a, self.a),
            "b": _json(self.rate_b, self.b),
            "difference": _bounds(self.difference),
        }


@dataclass(frozen=True)
class Time:
    """The median of one duration on both sides [s]; ``difference`` is B - A, by bootstrap."""

    name: str
    a_s: float | None
    b_s: float | None
    difference: Interval | None

    def to_json(self) -> Json:
        """Return the medians and bounds as a JSON object."""
        return {"name": self.name, "a_s": self.a_s, "b_s": self.b_s, "difference": _bounds(self.difference)}


@dataclass(frozen=True)
class Sides:
    """Two folders beside each other.

    Attributes:
        success: of all picks. ``held``: of those whose fingers closed. ``times``: of the cycles that came so far.
        codes: how often each ended a pick. ``objects``: success with each; "" = not named.
        made_by: of A and of B: how often each commit, and each configuration.
    """

    success: Rate
    held: Rate
    codes: tuple[Rate, ...]
    objects: tuple[Rate, ...]
    times: tuple[Time, ...]
    made_by: tuple[tuple[Counter[str], Counter[str]], tuple[Counter[str], Counter[str]]]

    @property
    def answer(self) -> str:
        """One sentence: better, worse, or not to be told from so many picks."""
        found = self.success.difference
        if found is None:
            return "One side has no picks: nothing can be said."
        said = f"{found.value * 100:+.1f} points of success ({found.low * 100:+.1f} to {found.high * 100:+.1f})"
        if found.excludes_zero:
            return f"B is {'better' if found.low > 0 else 'worse'}: {said}."
        one, other = self.success.rate_a, self.success.rate_b
        assert one is not None and other is not None
        needed = picks_needed(one.value, other.value)
        more = f" A difference of that size would need about {needed} picks a side." if needed else ""
        return f"Not to be told apart: {said}.{more}"

    def to_json(self) -> Json:
        """All figures as a JSON object."""
        return {
            "answer": self.answer,
            "success": self.success.to_json(),
            "held": self.held.to_json(),
            "codes": [one.to_json() for one in self.codes],
            "objects": [one.to_json() for one in self.objects],
            "times": [one.to_json() for one in self.times],
            "made_by": {
                side: {"commits": dict(commits), "stations": dict(stations)}
                for side, (commits, stations) in zip("ab", self.made_by, strict=True)
            },
        }


def _silent(_text: str) -> None:
    """Nothing is told."""


def compare_folders(a: Path, b: Path, day: str = "", progress: Progress = quietly, tell: Tell = _silent) -> Sides:
    """Compare the picks of two folders, whose catalogues are brought up to date first.

    Args:
        day: only these (UTC), e.g. ``2026-11-28``; "" = all. ``progress``, ``tell``: of `open_catalogue`.

    Raises: RecordingError, CatalogueError.
    """
    with ExitStack() as stack:
        both = [picks(stack.enter_context(open_catalogue(folder, progress, tell)), day) for folder in (a, b)]
    return compare_picks(*both)


def picks(catalogue: Catalogue, day: str = "") -> list[Pick]:
    """Return the picks of a catalogue: cycles that ended in SUCCESS, FAILED or ABORTED and were not tried again."""
    where, given = catalogue.where(day)
    sql = (
        f"SELECT {', '.join(Pick._fields)} FROM cycle WHERE {where}"
        " AND result IN ('SUCCESS', 'FAILED', 'ABORTED') AND coalesce(retried_as, '') = '' ORDER BY name"
    )
    return [Pick(*row) for row in catalogue.rows(sql, given)]


def compare_picks(a: list[Pick], b: list[Pick]) -> Sides:
    """As `compare_folders`, of the picks."""
    codes, objects = _values(a, b, lambda one: one.code), _values(a, b, lambda one: one.object or "")
    return Sides(
        success=_rate("success", a, b, _succeeded),
        held=_rate("held", _executed(a), _executed(b), lambda one: one.held == 1),
        codes=tuple(_rate(code, a, b, _ended_with(code)) for code in codes if code),
        objects=tuple(_rate(name, _with(name, a), _with(name, b), _succeeded) for name in objects),
        times=tuple(_time(name, a, b) for name in _TIMES),
        made_by=(_made_by(a), _made_by(b)),
    )


def _succeeded(one: Pick) -> bool:
    return one.result == "SUCCESS"


def _ended_with(code: str) -> Callable[[Pick], bool]:
    return lambda one: one.code == code


def _executed(side: list[Pick]) -> list[Pick]:
    return [one for one in side if one.executed == 1 and one.held is not None]


def _with(name: str, side: list[Pick]) -> list[Pick]:
    return [one for one in side if (one.object or "") == name]


def _values(a: list[Pick], b: list[Pick], take: Callable[[Pick], str]) -> list[str]:
    """The values of both sides, the most frequent first."""
    counts = Counter(map(take, [*a, *b]))
    return sorted(counts, key=lambda value: (-counts[value], value))


def _rate(name: str, a: Iterable[Pick], b: Iterable[Pick], counts: Callable[[Pick], bool]) -> Rate:
    one, other = ([counts(pick) for pick in side] for side in (a, b))
    return Rate(name, (sum(one), len(one)), (sum(other), len(other)))


def _time(name: str, a: list[Pick], b: list[Pick]) -> Time:
    one, other = ([value for pick in side if (value := getattr(pick, name)) is not None] for side in (a, b))
    a_s, b_s = (median(values) if values else None for values in (one, other))
    return Time(name, a_s, b_s, median_difference(one, other))


def _made_by(side: list[Pick]) -> tuple[Counter[str], Counter[str]]:
    return Counter(one.commit_id or "" for one in side), Counter(one.station_hash or "" for one in side)


def _json(found: Interval | None, counts: tuple[int, int]) -> Json:
    return {"n": counts[0], "of": counts[1], **(_bounds(found) or {"value": None, "low": None, "high": None})}


def _bounds(found: Interval | None) -> Json | None:
    return {name: round(value, 6) for name, value in found._asdict().items()} if found is not None else None
