"""Rows of judged scenes, and the figures of many."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.heaps.judge import TRUE
from benchmarks.heaps.plan import HEAPS

REFUSED = "refused"


@dataclass(frozen=True)
class Row:
    """One scene's outcome.

    Attributes:
        outcome: the judge's verdict on the best grasp, or `REFUSED`. ``why``: its words, or the refusal's code.
        feasible: the oracle's answer; None = it was not asked.
        cpu_ms: of the detection, after every look.
        pose: (4, 4) ``base_from_tcp`` of the best grasp, as nested tuples; None where refused. ``opening_m``: its own.
        lifted: whether a simulated lift touched nothing on its way down, and held one body; None = not simulated.
        views: number of views that the detection was given. ``extra_s``: planned motion to those after the first.
        set_name: as `plan.Plan`.
    """

    n: int
    seed: int
    kind: str
    pair: str
    outcome: str
    why: str
    feasible: bool | None
    cpu_ms: float
    pose: tuple[tuple[float, ...], ...] | None = None
    opening_m: float = float("nan")
    score: float = float("nan")
    lifted: bool | None = None
    views: int = 1
    extra_s: float = 0.0
    set_name: str = HEAPS

    @property
    def group(self) -> str:
        """The group that it is counted in: the number of objects in its heap, or its set."""
        return str(self.n) if self.set_name == HEAPS else self.set_name


def figures(rows: Sequence[Row]) -> dict[str, Any]:
    """By number of objects, as text, or set: shares of all scenes; ``true_grasp`` is a share of the feasible ones."""
    groups = dict.fromkeys(row.group for row in sorted(rows, key=lambda row: row.n))
    return {group: _of_one([row for row in rows if row.group == group]) for group in groups}


def _of_one(rows: Sequence[Row]) -> dict[str, Any]:
    asked = all(row.feasible is not None for row in rows)
    feasible = [row for row in rows if row.feasible or not asked]
    refused = [row for row in rows if row.outcome == REFUSED]
    cpu_ms = np.array([row.cpu_ms for row in rows])
    lifts = any(row.lifted is not None for row in rows)
    count = Counter(row.outcome for row in rows)
    return {
        "scenes": len(rows),
        "feasible": len(feasible) if asked else None,
        "true_grasp": _share([row for row in feasible if row.outcome == TRUE], feasible),
        **{
            name: round(count[name] / len(rows), 4)
            for name in (REFUSED, "seam", "collides", "slips", "thin", "off", "nothing")
        },
        "refused_feasible": _share([row for row in refused if row.feasible], feasible) if asked else None,
        "lifted": _share([row for row in feasible if row.lifted], feasible) if lifts else None,
        "refused_by_code": dict(Counter(row.why for row in refused)),
        "cpu_ms": {"median": round(float(np.median(cpu_ms))), "p95": round(float(np.percentile(cpu_ms, 95)))},
        "views": round(float(np.mean([row.views for row in rows])), 2),
        "extra_s": round(float(np.mean([row.extra_s for row in rows])), 2),
    }


def _share(some: Sequence[Row], of: Sequence[Row]) -> float | None:
    return round(len(some) / len(of), 4) if of else None
