"""Makes scenes or takes them from the cache, lets a detector see them, judges its best grasp, and counts."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.heaps import oracle
from benchmarks.heaps.check import against_physics
from benchmarks.heaps.detectors import Detect, Product
from benchmarks.heaps.drawn import Image, tile, write_tiles
from benchmarks.heaps.figures import REFUSED, Row, figures
from benchmarks.heaps.heap import Heap, obtain, path_of
from benchmarks.heaps.judge import TRUE, Judge
from benchmarks.heaps.lift import lift
from bus.errors import CycleFailure

COUNTS = (1, 3, 5, 10, 20)


@dataclass(frozen=True)
class Wanted:
    """One scene to measure.

    Attributes:
        objects, cache: where the objects' folder lies, and scenes are kept; None = nowhere.
        overrides: settings of the station, as ``key=value``.
        drawn, lifted: whether a picture of it, and a simulated lift, are wanted.
    """

    n: int
    seed: int
    objects: Path
    cache: Path | None
    overrides: tuple[str, ...] = ()
    drawn: bool = False
    lifted: bool = False


def evaluate(heaps: Iterable[Heap], detect: Detect, overrides: tuple[str, ...] = ()) -> list[Row]:
    """Let ``detect`` see each scene, and judge its best grasp.

    Args:
        overrides: settings of the station, as ``key=value``.
    """
    return [evaluate_one(heap, detect, overrides) for heap in heaps]


def evaluate_one(heap: Heap, detect: Detect, overrides: tuple[str, ...] = ()) -> Row:
    """Return the outcome of one scene; only a CycleFailure is a refusal."""
    observation, station = heap.observation(), heap.station(overrides)
    began_s = time.process_time()
    try:
        grasps = detect(observation, station)
    except CycleFailure as failure:
        cpu_ms = 1e3 * (time.process_time() - began_s)
        return Row(heap.n, heap.seed, heap.kind, heap.pair, REFUSED, str(failure.code), heap.feasible, cpu_ms)
    cpu_ms = 1e3 * (time.process_time() - began_s)
    best = grasps[0]
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
    """Return one scene with the oracle's answer, from the cache or made and kept there."""
    heap = obtain(one.n, one.seed, one.objects, one.cache)
    kept = None if one.cache is None else path_of(one.cache, one.n, one.seed).with_suffix(".oracle.json")
    return replace(heap, feasible=oracle.obtain(heap, kept).base_from_tcp is not None)


def run(
    counts: Sequence[int],
    development: Iterable[int],
    report: Iterable[int],
    wanted: Callable[[int, int], Wanted],
    jobs: int,
    sheet: Path | None,
    tell: Callable[[str], None],
) -> dict[str, Any]:
    """Return the report seeds' figures by number of objects, and those of the development seeds beside them.

    Args:
        sheet: where pictures of all scenes go, those without a true grasp first.
    """
    shown: dict[str, Any] = {}
    tiles: list[tuple[bool, Image]] = []
    for name, seeds in (("report", list(report)), ("development", list(development))):
        tasks = [replace(wanted(n, seed), drawn=sheet is not None) for n in counts for seed in seeds]
        rows: list[Row] = []
        for row, drawn in _measured(tasks, jobs):
            rows.append(row)
            tiles += [] if drawn is None else [(row.outcome == TRUE, drawn)]
            done = f"{name} {len(rows)}/{len(tasks)} n={row.n} seed={row.seed}{'' if row.feasible else ' infeasible'}"
            physics = {True: " lifted", False: " lost", None: ""}[row.lifted]
            tell(f"{done} {row.outcome} {row.why}{physics} {row.cpu_ms:.0f} ms")
        shown |= figures(rows) if name == "report" else {name: figures(rows)}
    if sheet is not None and tiles:
        write_tiles(sheet, [drawn for _, drawn in sorted(tiles, key=lambda one: one[0])])
    return shown


def check_judge(
    counts: Sequence[int], seeds: Iterable[int], wanted: Callable[[int, int], Wanted], lifts: int
) -> dict[str, Any]:
    """Return how often the judge and simulated lifts disagree; scenes in turn over ``seeds`` and ``counts``."""
    return against_physics(scenes(wanted(n, seed) for seed in seeds for n in counts), lifts)


def _measured(tasks: Sequence[Wanted], jobs: int) -> Iterator[tuple[Row, Image | None]]:
    """Yield rows, and pictures where they are wanted, in order, from ``jobs`` processes."""
    if jobs == 1:
        yield from map(_measure, tasks)
        return
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(_measure, tasks)


def _measure(one: Wanted) -> tuple[Row, Image | None]:
    cv2.setNumThreads(1)
    heap = scene(one)
    row = evaluate_one(heap, _product(), one.overrides)
    if one.lifted and row.pose is not None:
        done = lift(heap, np.array(row.pose), row.opening_m)
        row = replace(row, lifted=not done.touched and len(done.held) == 1)
    return row, tile(heap, row) if one.drawn else None


@cache
def _product() -> Product:
    return Product()
