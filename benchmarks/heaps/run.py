"""Makes scenes or takes them from the cache, lets a detector see them, judges its best grasp, and counts."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2

from benchmarks.heaps.detectors import Detect, Product
from benchmarks.heaps.figures import REFUSED, Row, figures
from benchmarks.heaps.heap import Heap, obtain
from benchmarks.heaps.judge import Judge
from bus.errors import CycleFailure

COUNTS = (1, 3, 5, 10, 20)


@dataclass(frozen=True)
class Wanted:
    """One scene to measure: where objects and cached scenes lie, and settings of the station as ``key=value``."""

    n: int
    seed: int
    objects: Path
    cache: Path | None
    overrides: tuple[str, ...] = ()


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


def run(
    counts: Sequence[int],
    development: Iterable[int],
    report: Iterable[int],
    wanted: Callable[[int, int], Wanted],
    jobs: int,
    tell: Callable[[str], None],
) -> dict[str, Any]:
    """Return the report seeds' figures by number of objects, and those of the development seeds beside them."""
    shown: dict[str, Any] = {}
    for name, seeds in (("report", list(report)), ("development", list(development))):
        tasks = [wanted(n, seed) for n in counts for seed in seeds]
        rows = []
        for row in _measured(tasks, jobs):
            rows.append(row)
            tell(
                f"{name} {len(rows)}/{len(tasks)} n={row.n} seed={row.seed} {row.outcome} {row.why} {row.cpu_ms:.0f} ms"
            )
        shown |= figures(rows) if name == "report" else {name: figures(rows)}
    return shown


def _measured(tasks: Sequence[Wanted], jobs: int) -> Iterator[Row]:
    """Yield the rows in order, from ``jobs`` processes."""
    if jobs == 1:
        yield from map(_measure, tasks)
        return
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(_measure, tasks)


def _measure(one: Wanted) -> Row:
    cv2.setNumThreads(1)
    return evaluate_one(obtain(one.n, one.seed, one.objects, one.cache), _product(), one.overrides)


@cache
def _product() -> Product:
    return Product()
