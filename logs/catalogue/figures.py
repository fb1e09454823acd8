"""Sums up cycles: picks an hour, success, what failed and how, who stepped in, the time lost by code."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import asdict, dataclass, field
from pathlib import Path

from bus.codec import Json
from bus.codes import Code
from logs.catalogue.catalogue import Catalogue, open_catalogue

INFEASIBLE = (Code.NO_GRASP, Code.UNREACHABLE, Code.COLLISION)
"""No grasp fits, or none can be reached."""
MULTI_PICK = "MULTI_PICK"
DEFINITIONS = {
    "cycles": "Attempts: recorded cycles that ended in SUCCESS, FAILED or ABORTED; not what ended EMPTY, was not"
    " finished or cannot be read.",
    "picks": "Those that were not tried again: each ends a pick.",
    "success": "Share of the picks that ended in SUCCESS.",
    "picks_per_hour": "Picks that ended in SUCCESS, an hour of cycles of any result; time between cycles is left out.",
    "attempts_per_pick": "Cycles a pick.",
    "executed": "Cycles in which the fingers closed.",
    "missed": "Share of the executed that was not held, by the verdict; those that ended DROPPED are left out.",
    "dropped": "Share of the executed that ended DROPPED: it slipped or was lost on the way.",
    "multi_pick": "Share of the executed that held more than one thing: MULTI_PICK.",
    "infeasible": f"Share of the picks that ended {', '.join(INFEASIBLE[:-1])} or {INFEASIBLE[-1]}: no grasp fits, or"
    " none can be reached.",
    "stops, aborts, holds": "Commanded by a client while a cycle was open.",
    "picks_between_stops": "Picks for each cycle that ended ABORTED, whoever stopped it; null: none did.",
    "lost_s": "Time of the cycles that ended in FAILED or ABORTED, by code.",
}
"""The meaning of each figure, in one sentence."""

_TRIED = "result IN ('SUCCESS', 'FAILED', 'ABORTED')"
_LAST = f"{_TRIED} AND retried_as = ''"
_SUMS = {
    "cycles": _TRIED,
    "empty": "result = 'EMPTY'",
    "picks": _LAST,
    "succeeded": f"{_LAST} AND result = 'SUCCESS'",
    "infeasible": f"{_LAST} AND code IN ({', '.join(repr(code.value) for code in INFEASIBLE)})",
    "executed": f"{_TRIED} AND executed = 1",
    "missed": f"{_TRIED} AND executed = 1 AND held = 0 AND code <> '{Code.DROPPED}'",
    "dropped": f"{_TRIED} AND executed = 1 AND code = '{Code.DROPPED}'",
    "multi_pick": f"{_TRIED} AND executed = 1 AND code = '{MULTI_PICK}'",
    "aborted": "result = 'ABORTED'",
}
_COUNTED = ("stops", "aborts", "holds")


@dataclass
class Counts:
    """Counts of some cycles; the rates are made of them.

    Attributes:
        busy_s: duration of all cycles. ``lost_s``: of those that failed, by code. ``codes``: how often each.
    """

    cycles: int = 0
    empty: int = 0
    picks: int = 0
    succeeded: int = 0
    infeasible: int = 0
    executed: int = 0
    missed: int = 0
    dropped: int = 0
    multi_pick: int = 0
    aborted: int = 0
    stops: int = 0
    aborts: int = 0
    holds: int = 0
    busy_s: float = 0.0
    cost_usd: float = 0.0
    lost_s: dict[str, float] = field(default_factory=dict)
    codes: dict[str, int] = field(default_factory=dict)

    def add(self, other: Counts) -> None:
        """Add the counts of other cycles."""
        for name, value in asdict(other).items():
            mine = getattr(self, name)
            if isinstance(mine, dict):
                for code, part in value.items():
                    mine[code] = mine.get(code, 0) + part
            else:
                setattr(self, name, mine + value)

    def to_json(self) -> Json:
        """Return the counts and rates; a rate of nothing is None."""
        return {
            "cycles": self.cycles,
            "picks": self.picks,
            "empty": self.empty,
            "success": _share(self.succeeded, self.picks),
            "picks_per_hour": round(3600 * self.succeeded / self.busy_s, 1) if self.busy_s > 0 else None,
            "attempts_per_pick": round(self.cycles / self.picks, 4) if self.picks else None,
            "executed": self.executed,
            "missed": _share(self.missed, self.executed),
            "dropped": _share(self.dropped, self.executed),
            "multi_pick": _share(self.multi_pick, self.executed),
            "infeasible": _share(self.infeasible, self.picks),
            "interventions": {name: getattr(self, name) for name in _COUNTED},
            "picks_between_stops": round(self.picks / self.aborted, 1) if self.aborted else None,
            "busy_s": round(self.busy_s, 1),
            "lost_s": {code: round(value, 1) for code, value in _most_first(self.lost_s)},
            "codes": dict(_most_first(self.codes)),
            "cost_usd": round(self.cost_usd, 4),
        }


@dataclass(frozen=True)
class Summary:
    """The counts of all selected cycles, and of each day, the newest first."""

    total: Counts
    days: dict[str, Counts]

    def to_json(self) -> Json:
        """All figures, with what they mean."""
        return {
            **self.total.to_json(),
            "days": {day: counts.to_json() for day, counts in self.days.items()},
            "definitions": DEFINITIONS,
        }


def summary(folder: Path, day: str = "") -> Summary:
    """Sum up the cycles of a folder of recordings, whose catalogue is brought up to date first.

    Args:
        day: ``2026-11-28`` or a prefix of a day (UTC); "" = all.

    Raises: RecordingError.
    """
    with open_catalogue(folder) as catalogue:
        return summed(catalogue, day)


def summed(catalogue: Catalogue, day: str = "") -> Summary:
    """As `summary`, of an open catalogue. Raises: CatalogueError."""
    where, given = catalogue.where(day)
    sums = ", ".join(f"coalesce(sum({condition}), 0)" for condition in _SUMS.values())
    counted = ", ".join(f"coalesce(sum({name}), 0)" for name in _COUNTED)
    others = f"coalesce(sum(CASE WHEN {_TRIED} OR result = 'EMPTY' THEN wall_s END), 0), coalesce(sum(cost_usd), 0)"
    sql = f"SELECT coalesce(day, ''), {sums}, {counted}, {others} FROM cycle WHERE {where} GROUP BY 1 ORDER BY 1 DESC"
    names = (*_SUMS, *_COUNTED, "busy_s", "cost_usd")
    days: dict[str, Counts] = defaultdict(Counts)
    for of, *values in catalogue.rows(sql, given):
        days[of] = Counts(**dict(zip(names, values, strict=True)))
    lost = (
        "SELECT coalesce(day, ''), code, count(*), coalesce(sum(wall_s), 0) FROM cycle"
        f" WHERE {where} AND result IN ('FAILED', 'ABORTED') GROUP BY 1, 2"
    )
    for of, code, count, lost_s in catalogue.rows(lost, given):
        days[of].codes[code], days[of].lost_s[code] = count, lost_s
    total = Counts()
    for counts in days.values():
        total.add(counts)
    return Summary(total, dict(days))


def _share(part: int, whole: int) -> float | None:
    """A share to a tenth of a percent: whoever shows it rounds it no more."""
    return round(part / whole, 3) if whole else None


def _most_first(values: dict[str, float] | dict[str, int]) -> list[tuple[str, float]]:
    return sorted(values.items(), key=lambda one: (-one[1], one[0]))
