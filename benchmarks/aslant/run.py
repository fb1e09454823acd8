"""Lets `vlad_cell.detect` see each picture, judges its best grasp on the true shapes, and counts. In metres."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.aslant.scenes import TILTS_DEG, Picture, scene
from benchmarks.heaps import oracle
from benchmarks.heaps.heap import Heap
from benchmarks.heaps.judge import TRUE, Judge
from benchmarks.heaps.lift import lift
from bus.errors import CycleFailure
from cell.workers import WorkerLost, Workers, ordered
from perception.grasps.closing import HOLD_M, TABLE_CLEARANCE_M
from vlad_cell import Grasp, detect

REFUSED = "refused"
_SHALLOW = 0.5
"""A grasp is shallow when it is less deep than this share of what pads and table would let it be."""


@dataclass(frozen=True)
class Row:
    """One picture's outcome.

    Attributes:
        outcome: the judge's verdict on the best grasp, or `REFUSED`; ``code`` then says why.
        feasible: whether the oracle finds a robust grasp from above.
        overlap_m: of both pads with the true thing, along the approach. ``depth``: its share of what could be.
        lifted: whether a simulated lift touched nothing on its way down, and held one body; None = not simulated.
    """

    tilt_deg: float
    outcome: str
    feasible: bool
    cpu_ms: float
    code: str = ""
    score: float = float("nan")
    overlap_m: float = float("nan")
    depth: float = float("nan")
    lifted: bool | None = None


def run(
    sets: Sequence[str],
    development: Iterable[int],
    report: Iterable[int],
    objects: Path,
    lifts: bool,
    workers: Workers,
    tell: Callable[[str], None],
) -> dict[str, Any]:
    """Return the report seeds' figures by set and tilt, and those of the development seeds beside them."""
    shown: dict[str, Any] = {}
    for name, seeds in (("report", list(report)), ("development", list(development))):
        found: dict[str, Any] = {}
        for set_name in sets:
            rows: list[Row] = []
            for one in ordered(workers, partial(_measured, set_name=set_name, objects=objects, lifts=lifts), seeds):
                if isinstance(one, WorkerLost):
                    raise one
                rows += one
                tell(f"{name} {set_name} {len(rows) // len(TILTS_DEG)}/{len(seeds)}")
            found[set_name] = figures(rows)
        shown |= found if name == "report" else {name: found}
    return shown


def figures(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the figures by tilt, as text."""
    return {
        f"{tilt_deg:g}": _of_one([row for row in rows if row.tilt_deg == tilt_deg])
        for tilt_deg in sorted({row.tilt_deg for row in rows})
    }


def _of_one(rows: Sequence[Row]) -> dict[str, Any]:
    """Shares of the feasible scenes; scores and depths of what was found in them."""
    feasible = [row for row in rows if row.feasible]
    found = [row for row in feasible if row.outcome != REFUSED]
    is_shallow = np.array([row.depth < _SHALLOW for row in found], dtype=bool)
    overlap_mm, score = np.array([[1e3 * row.overlap_m, row.score] for row in found]).reshape(-1, 2).T
    lifted = [row for row in found if row.lifted]
    return {
        "scenes": len(rows),
        "feasible": len(feasible),
        "found": _share(len(found), len(feasible)),
        "true_grasp": _share(sum(row.outcome == TRUE for row in found), len(feasible)),
        "lifted": _share(len(lifted), len(feasible)) if any(row.lifted is not None for row in found) else None,
        "overlap_mm": {"p10": _percentile(overlap_mm, 10), "median": _percentile(overlap_mm, 50)},
        "shallow": _share(int(is_shallow.sum()), len(found)),
        "score": {"shallow": _percentile(score[is_shallow], 50), "others": _percentile(score[~is_shallow], 50)},
        "outcomes": dict(Counter(row.code if row.outcome == REFUSED else row.outcome for row in feasible)),
        "cpu_ms": _percentile(np.array([row.cpu_ms for row in rows]), 50),
    }


def _share(some: int, of: int) -> float | None:
    return round(some / of, 4) if of else None


def _percentile(values: np.ndarray, share: float) -> float | None:
    return round(float(np.percentile(values, share)), 2) if len(values) else None


def _measured(seed: int, set_name: str, objects: Path, lifts: bool) -> list[Row]:
    cv2.setNumThreads(1)
    made = scene(set_name, seed, objects)
    feasible = oracle.search(made.truth).base_from_tcp is not None
    return [_row(picture, made.truth, feasible, lifts) for picture in made.pictures]


def _row(picture: Picture, truth: Heap, feasible: bool, lifts: bool) -> Row:
    """Let the detector see one picture; only a CycleFailure is a refusal."""
    began_s = time.process_time()
    try:
        found = detect(
            picture.color,
            picture.depth_m,
            picture.K,
            picture.base_from_camera,
            region_m=truth.station().scene.pick_region_m,
            settings={"camera.least_range_m": 0},
        )
    except CycleFailure as failure:
        cpu_ms = 1e3 * (time.process_time() - began_s)
        return Row(picture.tilt_deg, REFUSED, feasible, cpu_ms, str(failure.code))
    return _judged(found.grasps[0], picture.tilt_deg, truth, feasible, 1e3 * (time.process_time() - began_s), lifts)


def _judged(best: Grasp, tilt_deg: float, truth: Heap, feasible: bool, cpu_ms: float, lifts: bool) -> Row:
    judge, pose = Judge.of(truth), best.base_from_grasp
    overlap_m, edge_m = judge.overlap_m(pose, best.opening_m)
    most_m = min(HOLD_M, max(edge_m - TABLE_CLEARANCE_M, 1e-3))
    lifted = None
    if lifts:
        done = lift(truth, pose, best.opening_m)
        lifted = not done.touched and len(done.held) == 1
    verdict = judge.judge(pose, best.opening_m).name
    return Row(
        tilt_deg, verdict, feasible, cpu_ms, score=best.score, overlap_m=overlap_m, depth=overlap_m / most_m,
        lifted=lifted,
    )  # fmt: skip
