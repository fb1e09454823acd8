"""Recordings as data sets: how long a gigabyte of them takes, and whether the real LeRobot opens the result."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from benchmarks import lerobot_reader
from benchmarks.started import recorded_cycles
from cell.workers import LocalWorkers, Workers, ordered, workers_for
from logs.catalogue import open_catalogue
from logs.export import Done, Runner, Selection, export_grasps, export_lerobot, select

_GB = 1e9


def run(
    cycles: int, seed: int, folder: Path | None, endpoint: str, workers: int | None, tell: Callable[[str], None]
) -> dict[str, Any]:
    """Export simulated cycles, or the recordings of a folder: by one process alone, then by several.

    Args:
        workers: processes that read and encode; None = as `cell export` takes them.

    Returns:
        ``s_per_gb``: LeRobot's data set, of recordings, by the wall, with the start of its ``workers``;
        ``cpu_s_per_gb``: of one process alone. ``equal``: both give the same bytes. ``frames``, ``episodes`` of it and
        its size. ``grasps_s_per_gb``, ``grasps_cpu_s_per_gb``, ``grasps``: of the other one.
        ``loads_in_lerobot``: whether LeRobot gives its first and its last frame; None without `just lerobot`.
    """
    with TemporaryDirectory() as name:
        made = Path(name)
        if folder is None:
            recorded_cycles(made / "recordings", endpoint, cycles, seed)
        with open_catalogue(folder or made / "recordings") as catalogue:
            chosen = select(catalogue)
        crew = workers_for(len(chosen.paths), workers, "")
        tell(f"{len(chosen.paths)} recordings, {crew}")
        lerobot = _twice(chosen, made, "lerobot", lambda some, to, run: export_lerobot(some, to, _all, run=run), crew)
        tell(f"LeRobot: {lerobot.done.counts}, {lerobot.s_per_gb} s a GB")
        grasps = _twice(chosen, made, "grasps", lambda some, to, run: export_grasps(some, to, _all, run), crew)
        tell(f"grasps: {grasps.done.counts}, {grasps.s_per_gb} s a GB")
        return {
            "s_per_gb": lerobot.s_per_gb,
            "cpu_s_per_gb": lerobot.cpu_s_per_gb,
            "equal": lerobot.equal and grasps.equal,
            "frames": lerobot.done.counts["frames"],
            "episodes": lerobot.done.counts["episodes"],
            "bytes": sum(path.stat().st_size for path in (made / "lerobot").rglob("*") if path.is_file()),
            "recordings_bytes": lerobot.done.recordings_bytes,
            "workers": getattr(crew, "count", None),
            "grasps": grasps.done.counts["grasps"],
            "grasps_s_per_gb": grasps.s_per_gb,
            "grasps_cpu_s_per_gb": grasps.cpu_s_per_gb,
            "loads_in_lerobot": _opened(made / "lerobot", lerobot.done.counts["frames"]),
        }


class _Twice(NamedTuple):
    """An export by several processes [s of the wall a GB], and by one [s of the processor a GB]."""

    done: Done
    s_per_gb: float
    cpu_s_per_gb: float
    equal: bool


def _twice(
    chosen: Selection, made: Path, name: str, export: Callable[[Selection, Path, Runner], Done], crew: Workers
) -> _Twice:
    began_s = time.process_time()
    alone = export(
        Selection(list(chosen.paths), chosen.root), made / f"{name}-alone", partial(ordered, LocalWorkers(1))
    )
    cpu_s = time.process_time() - began_s
    began_s = time.perf_counter()
    done = export(Selection(list(chosen.paths), chosen.root), made / name, partial(ordered, crew))
    wall_s = time.perf_counter() - began_s
    gb = done.recordings_bytes / _GB
    is_equal = alone.counts == done.counts and _content(made / f"{name}-alone") == _content(made / name)
    return _Twice(done, round(wall_s / gb, 1), round(cpu_s / gb, 1), is_equal)


def _content(folder: Path) -> dict[Path, str]:
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def _all(paths: Any, _total: int) -> Any:
    return paths


def _opened(root: Path, frames: int) -> bool | None:
    if not lerobot_reader.is_there():
        return None
    try:
        return bool(lerobot_reader.opened(root, [0, frames - 1])["frames"] == frames)
    except RuntimeError:
        return False
