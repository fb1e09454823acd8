"""Failures of a soak in groups: does each injected fault fall into a group of its own?"""

from __future__ import annotations

import json
from bisect import bisect_right
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from math import comb
from pathlib import Path
from typing import Any

from bus.errors import RecordingError
from logs.alike.features import space
from logs.alike.groups import group_failures
from logs.catalogue import open_catalogue

NONE = "none"


def run(state: Path, folder: Path) -> dict[str, Any]:
    """Group the failures of a soak.

    Args:
        state: its progress file. ``folder``: its recordings, all of them (`benchmarks soak --keep`).

    Returns:
        ``index``: adjusted Rand index between fault and group, 1 = the same partition, 0 = as good as chance.
        ``failures``, ``faults``, ``groups``: how many. ``sentences``: of each group, with its faults.

    Raises: RecordingError when nothing failed.
    """
    with open_catalogue(folder) as catalogue:
        where = space(catalogue)
    injected = _injected(state)
    groups = group_failures(where)
    if not groups:
        raise RecordingError(f"Nothing in {folder} failed.", "Name the folder of a soak with faults.")
    told = [(_fault(injected, cycle), number) for number, group in enumerate(groups) for cycle in group.cycles]
    faults: defaultdict[int, Counter[str]] = defaultdict(Counter)
    for fault, number in told:
        faults[number][fault] += 1
    return {
        "index": round(adjusted_rand([fault for fault, _ in told], [number for _, number in told]), 3),
        "failures": len(told),
        "faults": len({fault for fault, _ in told}),
        "groups": len(groups),
        "sentences": [{"faults": faults[number], "says": group.sentence} for number, group in enumerate(groups)],
    }


def _injected(state: Path) -> list[tuple[str, str]]:
    """Id of the first cycle of each trial, and its fault, in order of time."""
    outcomes = json.loads(state.read_text())["outcomes"]
    return sorted((Path(one["recording"]).stem, one["fault"] or NONE) for one in outcomes if one["recording"])


def _fault(injected: Sequence[tuple[str, str]], cycle_id: str) -> str:
    """The fault of the trial that a cycle belongs to: further attempts of one follow its first."""
    at = bisect_right(injected, cycle_id, key=lambda one: one[0])
    return injected[at - 1][1] if at else NONE


def adjusted_rand(one: Iterable[object], other: Iterable[object]) -> float:
    """1: the same groups; 0: as good as chance."""
    first, second = list(one), list(other)
    both, mine, theirs = (
        sum(comb(count, 2) for count in Counter(some).values())
        for some in (zip(first, second, strict=True), first, second)
    )
    by_chance = mine * theirs / comb(len(first), 2)
    return (both - by_chance) / ((mine + theirs) / 2 - by_chance)
