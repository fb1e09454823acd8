"""The catalogue of many cycles: how long a row, a list, a sum and a query take, and how fast it is made anew."""

from __future__ import annotations

import os
import random
import shutil
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks.started import recorded_cycle
from bus.codes import Code
from logs.catalogue import open_catalogue
from logs.catalogue.ask import ask
from logs.catalogue.column import Value
from logs.catalogue.columns import NAMES
from logs.catalogue.figures import summed
from logs.catalogue.opening import open_store
from logs.catalogue.rows import file_of, row_of
from logs.catalogue.store import CATALOGUE
from logs.mcap.index import Filter

_A_DAY = 1000
_FIRST = datetime(2026, 1, 1, 6, tzinfo=UTC)
_INSERTS = 200
_READ = 200
_REPEATS = 5
_BATCH = 1000
_CODES = (Code.NO_GRASP, Code.GRASP_MISSED, Code.DROPPED, Code.COLLISION)
QUERIES = (
    "SELECT code, count(*) FROM cycles GROUP BY code",
    "SELECT day, avg(score), avg(load_n), avg(detect_s) FROM cycles GROUP BY day",
    "SELECT j.key, avg(j.value) FROM cycles, json_each(terms) AS j WHERE code = 'NO_GRASP' GROUP BY 1",
    "SELECT cycle_id, reason FROM cycles ORDER BY started_ns DESC LIMIT 50",
)


def run(cycles: int, endpoint: str, given: Path | None, tell: Callable[[str], None]) -> dict[str, Any]:
    """Rows of one recorded cycle, varied, each with an empty file of its own; then recordings that are read.

    Args:
        endpoint: for the cell that records the cycle; ``given``: its recording, instead.

    Returns:
        ``insert``: median and 99th percentile of making one row of its recording, and of inserting it, synced [ms].
        ``lists_ms``: all cycles, the newest 50, all of them summed up by day; each with the look for new files.
        ``queries_ms``: each of `QUERIES`, with that look. Of both, CPU time [ms] and wall time [ms], medians.
        ``insert_ms``, ``list_ms``, ``query_ms``: the first of each; of the last two the CPU time.
        ``bytes``: of the file. ``rebuild_per_s``: recordings that are read in a second of CPU time.
    """
    with TemporaryDirectory() as name:
        folder = Path(name)
        recording = given or recorded_cycle(folder / "cell", endpoint)
        many = folder / "many"
        insert = _inserted(folder / "few", recording)
        tell(f"one row: {insert}")
        _fill(many, recording, cycles, tell)
        listing = _listed(many)
        tell(f"lists: {listing}")
        queries = {sql: _ms(lambda sql=sql: _asked(many, sql)) for sql in QUERIES}  # type: ignore[misc]
        tell(f"queries: {queries}")
        return {
            "cycles": cycles,
            "insert_ms": insert["insert"][0],
            "list_ms": listing["all"][0],
            "query_ms": queries[QUERIES[0]][0],
            "bytes": (many / CATALOGUE).stat().st_size,
            "rebuild_per_s": _rebuilt(folder / "copies", recording),
            "insert": insert,
            "lists_ms": listing,
            "queries_ms": queries,
        }


def _inserted(folder: Path, recording: Path) -> dict[str, tuple[float, float]]:
    """Median and 99th percentile [ms] of one row, as the daemon writes it after a cycle."""
    folder.mkdir()
    path = shutil.copy(recording, folder / recording.name)
    store, made_ms, put_ms = open_store(folder), [], []
    for number in range(_INSERTS):
        began_s = time.perf_counter()
        row = row_of(folder, file_of(Path(path), folder))
        made_s = time.perf_counter()
        store.put([(f"{number}.mcap", *row[1:])])
        made_ms.append((made_s - began_s) * 1e3)
        put_ms.append((time.perf_counter() - made_s) * 1e3)
    store.close()
    return {"read": _spread(made_ms), "insert": _spread(put_ms)}


def _fill(folder: Path, recording: Path, cycles: int, tell: Callable[[str], None]) -> None:
    """A catalogue of so many cycles, a thousand a day, and their files, which are empty."""
    folder.mkdir()
    store, rows = open_store(folder), []
    for row in _varied(folder, recording, cycles):
        rows.append(row)
        if len(rows) == _BATCH:
            store.put(rows)
            rows.clear()
    store.put(rows)
    store.close()
    for day in folder.iterdir():
        if day.is_dir():
            os.utime(day, (_FIRST.timestamp(), _FIRST.timestamp()))
    began_s = time.perf_counter()
    with open_catalogue(folder) as catalogue:
        assert catalogue.made == 0, "every file has a row"
    tell(f"{cycles} rows; their folders listed for the first time: {time.perf_counter() - began_s:.1f} s")


def _varied(folder: Path, recording: Path, cycles: int) -> Iterator[tuple[Value, ...]]:
    like = dict(zip(NAMES, row_of(recording.parent, file_of(recording, recording.parent)), strict=True))
    rng = random.Random(0)
    for number in range(cycles):
        began = _FIRST + timedelta(days=number // _A_DAY, seconds=30 * (number % _A_DAY))
        day, cycle_id = f"{began:%Y-%m-%d}", f"{began:%Y%m%dT%H%M%S%f}"[:-3]
        path = folder / day / f"{cycle_id}.mcap"
        path.parent.mkdir(exist_ok=True)
        path.touch()
        code = rng.choice(_CODES).value if rng.random() < 0.1 else ""
        of: dict[str, Value] = {
            "file": f"{day}/{path.name}", "folder": day, "name": path.name, "bytes": 0,
            "mtime_ns": path.stat().st_mtime_ns, "cycle_id": cycle_id, "day": day,
            "started_ns": round(began.timestamp() * 1e9), "result": "FAILED" if code else "SUCCESS", "code": code,
            "wall_s": rng.uniform(5, 9), "score": rng.random(), "load_n": rng.random(), "detect_s": rng.random(),
        }  # fmt: skip
        yield tuple((like | of).values())


def _listed(folder: Path) -> dict[str, tuple[float, float]]:
    def entries(last: int | None) -> None:
        with open_catalogue(folder) as catalogue:
            for _ in catalogue.entries(Filter(last=last)):
                pass

    def sums() -> None:
        with open_catalogue(folder) as catalogue:
            summed(catalogue).to_json()

    return {"all": _ms(lambda: entries(None)), "newest_50": _ms(lambda: entries(50)), "sums": _ms(sums)}


def _asked(folder: Path, sql: str) -> None:
    with open_catalogue(folder) as catalogue:
        ask(catalogue, sql)


def _rebuilt(folder: Path, recording: Path) -> float:
    """Recordings a second of CPU time that are read into a new catalogue."""
    folder.mkdir()
    for number in range(_READ):
        shutil.copy(recording, folder / f"{number}.mcap")
    began_s = time.process_time()
    with open_catalogue(folder) as catalogue:
        assert catalogue.made == _READ
    return round(_READ / (time.process_time() - began_s), 1)


def _ms(work: Callable[[], None]) -> tuple[float, float]:
    """Median CPU and wall time of some repeats [ms]."""
    cpu_ms, wall_ms = [], []
    for _ in range(_REPEATS):
        began_s, cpu_s = time.perf_counter(), time.process_time()
        work()
        cpu_ms.append((time.process_time() - cpu_s) * 1e3)
        wall_ms.append((time.perf_counter() - began_s) * 1e3)
    return round(median(cpu_ms), 1), round(median(wall_ms), 1)


def _spread(values_ms: list[float]) -> tuple[float, float]:
    ordered = sorted(values_ms)
    return round(median(ordered), 2), round(ordered[int(0.99 * (len(ordered) - 1))], 2)
