"""Makes scenes or takes them from the cache, lets a detector see them, judges its best grasp, and counts."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.heaps import oracle, sides, views
from benchmarks.heaps.check import against_physics
from benchmarks.heaps.detectors import Detect, Found, Product, WhyLookAgain
from benchmarks.heaps.drawn import Image, tile, write_tiles
from benchmarks.heaps.figures import REFUSED, Row, figures
from benchmarks.heaps.heap import Heap, obtain, path_of
from benchmarks.heaps.judge import TRUE, Judge
from benchmarks.heaps.lift import lift
from benchmarks.heaps.plan import HEAPS
from bus.errors import CycleFailure
from bus.messages import Observation
from cell.pick.looking import why_look_again
from cell.workers import WorkerLost, Workers, ordered
from config.schema import Station

COUNTS = (1, 3, 5, 10, 20)
Group = tuple[str, int]
"""A set of scenes and the number of things in each."""
LOOKS = {"1": (1, 1), "2": (2, 2), "3": (3, 3), "auto": (1, 3)}
"""How many views the first detection is given, and how many the last at most; between them the cell's rule decides."""


@dataclass(frozen=True)
class Wanted:
    """One scene to measure.

    Attributes:
        objects, cache: where the objects' folder lies, and scenes are kept; None = nowhere.
        overrides: settings of the station, as ``key=value``.
        drawn, lifted: whether a picture of it, and a simulated lift, are wanted.
        set_name: as `plan.Plan`. ``looks``: as in `LOOKS`.
    """

    n: int
    seed: int
    objects: Path
    cache: Path | None
    overrides: tuple[str, ...] = ()
    drawn: bool = False
    lifted: bool = False
    set_name: str = HEAPS
    looks: tuple[int, int] = LOOKS["1"]


def evaluate(heaps: Iterable[Heap], detect: Detect, overrides: tuple[str, ...] = ()) -> list[Row]:
    """Let ``detect`` see each scene, and judge its best grasp.

    Args:
        overrides: settings of the station, as ``key=value``.
    """
    return [evaluate_one(heap, detect, overrides) for heap in heaps]


def evaluate_one(
    heap: Heap,
    detect: Detect,
    overrides: tuple[str, ...] = (),
    looks: tuple[int, int] = LOOKS["1"],
    again: WhyLookAgain = why_look_again,
    seen: Callable[[Heap], Heap] = lambda heap: heap,
) -> Row:
    """Return the outcome of one scene; only a CycleFailure is a refusal.

    Args:
        looks: views of the first detection, and at most. ``again``: asked in between whether to look once more.
        seen: returns the scene with its further views; called when the first of them is wanted.
    """
    station, (count, most), cpu_ms = heap.station(overrides), looks, 0.0
    while True:
        heap = seen(heap) if count > 1 and not heap.further else heap
        outcome, took_ms = _detected(heap.observations()[:count], station, detect)
        cpu_ms += took_ms
        if count == most or not again(outcome, count, station):
            break
        count += 1
    extra_s = sum(look.motion_s for look in heap.further[: count - 1])
    if isinstance(outcome, CycleFailure):
        told = Row(heap.n, heap.seed, heap.kind, heap.pair, REFUSED, str(outcome.code), heap.feasible, cpu_ms)
    else:
        told = _judged(heap, outcome, cpu_ms)
    return replace(told, views=count, extra_s=extra_s, set_name=heap.set_name)


def _detected(
    observations: Sequence[Observation], station: Station, detect: Detect
) -> tuple[Found | CycleFailure, float]:
    """Return the outcome, and its CPU time [ms]."""
    began_s = time.process_time()
    outcome: Found | CycleFailure
    try:
        outcome = detect(observations, station)
    except CycleFailure as failure:
        outcome = failure
    return outcome, 1e3 * (time.process_time() - began_s)


def _judged(heap: Heap, found: Found, cpu_ms: float) -> Row:
    best = found.grasps[0]
    verdict = Judge.of(heap).judge(best.base_from_tcp, best.opening_m)
    pose = tuple(tuple(float(value) for value in row) for row in best.base_from_tcp)
    return Row(
        heap.n, heap.seed, heap.kind, heap.pair, verdict.name, verdict.why, heap.feasible, cpu_ms,
        pose, best.opening_m, best.score,
    )  # fmt: skip


def scenes(tasks: Iterable[Wanted]) -> Iterator[Heap]:
    """Yield each scene with the oracle's answer, from the cache or made and kept there."""
    return (scene(one) for one in tasks)


def scene(one: Wanted) -> Heap:
    """Return one scene with the oracle's answer, from the cache or made and kept there.

    Of more than one look, what can be picked from any side counts as feasible, too.
    """
    heap = obtain(one.n, one.seed, one.objects, one.cache, one.set_name)
    found = oracle.obtain(heap, _kept(one, ".oracle.json"))
    if found.base_from_tcp is None and one.looks != LOOKS["1"]:
        found = oracle.obtain(heap, _kept(one, ".sides.json"), sides.search)
    return replace(heap, feasible=found.base_from_tcp is not None)


def _kept(one: Wanted, suffix: str) -> Path | None:
    """The oracle's file, beside the scene's."""
    return None if one.cache is None else path_of(one.cache, one.n, one.seed, one.set_name).with_suffix(suffix)


def run(
    groups: Sequence[Group],
    development: Iterable[int],
    report: Iterable[int],
    wanted: Callable[[Group, int], Wanted],
    workers: Workers,
    sheet: Path | None,
    tell: Callable[[str], None],
) -> dict[str, Any]:
    """Return the report seeds' figures by number of objects or set, and those of the development seeds beside them.

    Args:
        workers: who makes, sees and judges the scenes; the rows are the same whoever does.
        sheet: where pictures of all scenes go, those without a true grasp first.
    """
    shown: dict[str, Any] = {}
    tiles: list[tuple[bool, Image]] = []
    for name, seeds in (("report", list(report)), ("development", list(development))):
        tasks = [replace(wanted(group, seed), drawn=sheet is not None) for group in groups for seed in seeds]
        rows: list[Row] = []
        for row, drawn in _measured(tasks, workers):
            rows.append(row)
            tiles += [] if drawn is None else [(row.outcome == TRUE, drawn)]
            which = f"n={row.n}" if row.set_name == HEAPS else row.set_name
            done = f"{name} {len(rows)}/{len(tasks)} {which} seed={row.seed}{'' if row.feasible else ' infeasible'}"
            physics = {True: " lifted", False: " lost", None: ""}[row.lifted]
            tell(f"{done} {row.outcome} {row.why}{physics} {row.cpu_ms:.0f} ms")
        shown |= figures(rows) if name == "report" else {name: figures(rows)}
    if sheet is not None and tiles:
        write_tiles(sheet, [drawn for _, drawn in sorted(tiles, key=lambda one: one[0])])
    return shown


def check_judge(
    groups: Sequence[Group], seeds: Iterable[int], wanted: Callable[[Group, int], Wanted], lifts: int
) -> dict[str, Any]:
    """Return how often the judge and simulated lifts disagree; scenes in turn over ``seeds`` and ``groups``."""
    return against_physics(scenes(wanted(group, seed) for seed in seeds for group in groups), lifts)


def _measured(tasks: Sequence[Wanted], workers: Workers) -> Iterator[tuple[Row, Image | None]]:
    """Yield rows, and pictures where they are wanted, in order. Raises: WorkerLost when no worker survives one."""
    for found in ordered(workers, _measure, tasks):
        if isinstance(found, WorkerLost):
            raise found
        yield found


def _measure(one: Wanted) -> tuple[Row, Image | None]:
    cv2.setNumThreads(1)
    heap = scene(one)
    row = evaluate_one(
        heap, _product(), one.overrides, one.looks, seen=lambda heap: views.with_views(heap, one.objects, one.cache)
    )
    if one.lifted and row.pose is not None:
        done = lift(heap, np.array(row.pose), row.opening_m)
        row = replace(row, lifted=not done.touched and len(done.held) == 1)
    return row, tile(heap, row) if one.drawn else None


@cache
def _product() -> Product:
    return Product()
