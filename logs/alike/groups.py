"""The nearest cycles to one, and failures in groups, each with a sentence and examples."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any, NamedTuple

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from bus.codec import Json
from logs.alike.features import FAMILIES, Labels, Space

ALIKE = 0.15
"""Failures whose groups are less than this apart on average belong together. See docs/alike.md for what it means."""
_MOST = 3000
"""So many failures are grouped with each other; further, older ones join the group they are nearest to."""
_EXAMPLES = 3
_MOST_OF_THEM = 0.6
_SAME, _OTHER = 0.05, 0.25
"""Shares of a family that differ, below which it is the same, above which it differs."""


class Neighbour(NamedTuple):
    """A cycle near another; ``by_family``: how far in each, 0..1."""

    cycle_id: str
    distance: float
    row: dict[str, Any]
    by_family: dict[str, float]

    def to_json(self) -> Json:
        """Return the fields as a JSON object."""
        return {**self.row, "distance": round(self.distance, 4), "by_family": _rounded(self.by_family)}

    def in_words(self) -> str:
        """Return what is the same and what differs, in words."""
        same = [family for family, apart in self.by_family.items() if apart < _SAME]
        other = [family for family, apart in self.by_family.items() if apart >= _OTHER]
        parts = [("the same: ", same), ("another: ", other)]
        return "; ".join(word + ", ".join(families) for word, families in parts if families)


@dataclass(frozen=True)
class Group:
    """Failures that are alike.

    Attributes:
        cycles: their ids, in order of time. ``sentence``: what they have in common.
        examples: the most typical one first, then the newest, then the one that is least like the first.
        width: mean distance of its cycles from the most typical one.
    """

    cycles: tuple[str, ...]
    sentence: str
    examples: tuple[str, ...]
    width: float

    def to_json(self) -> Json:
        """Return the fields as a JSON object."""
        return {"count": len(self.cycles), **asdict(self)}


def nearest(where: Space, cycle_id: str, count: int) -> list[Neighbour]:
    """Return the cycles nearest to one, nearest first; of equals the newest. Raises: KeyError for an unknown one."""
    try:
        one = where.ids.index(cycle_id)
    except ValueError:
        raise KeyError(cycle_id) from None
    apart = where.distances([one], np.arange(len(where.ids)))[0]
    order = [int(other) for other in np.lexsort((-np.arange(len(apart)), apart)) if other != one]
    return [
        Neighbour(where.ids[other], float(apart[other]), where.rows[other], where.by_family(one, other))
        for other in order[:count]
    ]


def group_failures(where: Space, alike: float = ALIKE) -> list[Group]:
    """All failed and aborted cycles in groups, the largest first; one that is like no other is a group of one."""
    failed = [index for index, row in enumerate(where.rows) if row["result"] in ("FAILED", "ABORTED")]
    labels = label_failures(where, failed, alike)
    members: dict[int, list[int]] = {}
    for index, label in zip(failed, labels.tolist(), strict=True):
        members.setdefault(label, []).append(index)
    groups = [_group(where, some) for some in members.values()]
    return sorted(groups, key=lambda group: (-len(group.cycles), group.cycles))


def label_failures(where: Space, failed: Sequence[int], alike: float = ALIKE) -> Labels:
    """Return the number of the group of each of these cycles, by average linkage cut at ``alike``."""
    if len(failed) < 2:
        return np.zeros(len(failed), np.intp)
    newest, older = failed[-_MOST:], failed[:-_MOST]
    apart = where.failures_apart(newest, newest).astype(float)
    np.fill_diagonal(apart, 0.0)
    tree = linkage(squareform(apart, checks=False), "average")
    labels: Labels = np.asarray(fcluster(tree, alike, "distance"), np.intp)
    if not older:
        return labels
    near = where.failures_apart(older, newest)
    joined = labels[near.argmin(axis=1)]
    alone = near.min(axis=1) > alike
    joined[alone] = labels.max() + 1 + np.arange(int(alone.sum()))
    return np.concatenate([joined, labels])


def _group(where: Space, some: Sequence[int]) -> Group:
    sample = np.asarray(some[-_MOST:], np.intp)
    apart = where.failures_apart(sample, sample)
    typical = int(apart.sum(axis=1).argmin())
    order = [typical, len(sample) - 1, int(apart[typical].argmax())]
    rest = [int(index) for index in apart[typical].argsort(kind="stable")]
    examples = list(dict.fromkeys([*order, *rest]))[:_EXAMPLES]
    return Group(
        cycles=tuple(where.ids[index] for index in some),
        sentence=_sentence(where, some, int(sample[typical])),
        examples=tuple(where.ids[int(sample[index])] for index in examples),
        width=round(float(apart[typical].mean()), 4),
    )


# --- the sentence -----------------------------------------------------------------------------------------------------


def _sentence(where: Space, some: Sequence[int], typical: int) -> str:
    rows = [where.rows[index] for index in some]
    count = f"{len(rows)} cycles" if len(rows) > 1 else "One cycle"
    codes = ", ".join(code or "no code" for code, _ in Counter(row["code"] for row in rows).most_common(3))
    usual, times = Counter(row["failed_stage"] for row in rows).most_common(1)[0]
    stage = f" in {usual}" if usual and times >= _MOST_OF_THEM * len(rows) else ""
    reason = str(where.rows[typical]["reason"] or "no reason").rstrip(".")
    return f"{count} ended {codes}{stage}{_object(where, rows)}{_time(rows)}: {reason}."


def _object(where: Space, rows: Sequence[dict[str, Any]]) -> str:
    """The object that most of them have, where that says something: it is rarer among all cycles."""
    name, count = Counter(row["object"] for row in rows).most_common(1)[0]
    share, usual = count / len(rows), sum(row["object"] == name for row in where.rows) / len(where.rows)
    says_it = name and len(rows) > 1 and share >= _MOST_OF_THEM and share > usual * 1.5
    return f" with {name} ({count} of them)" if says_it else ""


def _time(rows: Sequence[dict[str, Any]]) -> str:
    days = sorted({_day(row["started_ns"]) for row in rows if row["started_ns"] is not None})
    if not days:
        return ""
    return f" on {days[0]}" if len(days) == 1 else f" from {days[0]} to {days[-1]}"


def _day(at_ns: int) -> str:
    return datetime.fromtimestamp(at_ns / 1e9, UTC).strftime("%Y-%m-%d")


def _rounded(values: dict[str, float]) -> dict[str, float]:
    return {family: round(values[family], 4) for family in FAMILIES}
