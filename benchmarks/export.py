"""Recordings as data sets: how long a gigabyte of them takes, and whether the real LeRobot opens the result."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks import lerobot_reader
from benchmarks.started import recorded_cycles
from logs.catalogue import open_catalogue
from logs.export import Done, Selection, export_grasps, export_lerobot, select

_GB = 1e9


def run(cycles: int, seed: int, folder: Path | None, endpoint: str, tell: Callable[[str], None]) -> dict[str, Any]:
    """Export simulated cycles, or the recordings of a folder.

    Returns:
        ``s_per_gb``, ``cpu_s_per_gb``: LeRobot's data set, of recordings, by the wall and by the processor; ``frames``,
        ``episodes`` of it and its size. ``grasps_s_per_gb``, ``grasps_cpu_s_per_gb``, ``grasps``: of the other one.
        ``loads_in_lerobot``: whether LeRobot gives its first and its last frame; None without `just lerobot`.
    """
    with TemporaryDirectory() as name:
        made = Path(name)
        if folder is None:
            recorded_cycles(made / "recordings", endpoint, cycles, seed)
        with open_catalogue(folder or made / "recordings") as catalogue:
            chosen = select(catalogue)
        tell(f"{len(chosen.paths)} recordings")
        lerobot, wall_s, cpu_s = _timed(chosen, lambda some: export_lerobot(some, made / "lerobot", _silently))
        tell(f"LeRobot: {lerobot.counts}, {wall_s:.1f} s")
        grasps, grasps_s, grasps_cpu_s = _timed(chosen, lambda some: export_grasps(some, made / "grasps", _silently))
        tell(f"grasps: {grasps.counts}, {grasps_s:.1f} s")
        return {
            "s_per_gb": round(wall_s / lerobot.recordings_bytes * _GB, 1),
            "cpu_s_per_gb": round(cpu_s / lerobot.recordings_bytes * _GB, 1),
            "frames": lerobot.counts["frames"],
            "episodes": lerobot.counts["episodes"],
            "bytes": sum(path.stat().st_size for path in (made / "lerobot").rglob("*") if path.is_file()),
            "recordings_bytes": lerobot.recordings_bytes,
            "grasps": grasps.counts["grasps"],
            "grasps_s_per_gb": round(grasps_s / grasps.recordings_bytes * _GB, 1),
            "grasps_cpu_s_per_gb": round(grasps_cpu_s / grasps.recordings_bytes * _GB, 1),
            "loads_in_lerobot": _opened(made / "lerobot", lerobot.counts["frames"]),
        }


def _silently(paths: Any, _total: int) -> Any:
    return paths


def _timed(chosen: Selection, export: Callable[[Selection], Done]) -> tuple[Done, float, float]:
    """What was exported, and the time of the wall and of the processor [s]."""
    began_s, began_cpu_s = time.perf_counter(), time.process_time()
    done = export(Selection(list(chosen.paths), chosen.root))
    return done, time.perf_counter() - began_s, time.process_time() - began_cpu_s


def _opened(root: Path, frames: int) -> bool | None:
    if not lerobot_reader.is_there():
        return None
    try:
        return bool(lerobot_reader.opened(root, [0, frames - 1])["frames"] == frames)
    except RuntimeError:
        return False
