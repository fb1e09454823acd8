"""``cell start --cycles N`` on a machine that is busy with something else: does it succeed, and how long does it take?

Beside every start run busy loops of the same priority, in the cell's own session: the scheduler, which shares the
cores among sessions first, then gives the cell one part in as many as there are loops. ``bare``: as on a machine just
installed, with no compiled modules and no translated shaders.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from benchmarks.openness import trouble

_LOOP = "while 1: pass"
_PATIENCE_S = 3600.0
"""A start that takes longer hangs."""


class Started(NamedTuple):
    """One start: how many of its picks succeeded, how long it took, and why it failed; "" when it did not.

    Attributes:
        unreadable: what is wrong with its recordings.
    """

    picked: int
    wall_s: float
    failure: str
    unreadable: tuple[str, ...] = ()


def run(
    starts: int, cycles: int, loops: int, bare: bool, overrides: list[str], tell: Callable[[str], None]
) -> dict[str, Any]:
    """``starts`` one after the other, each of ``cycles`` picks beside ``loops`` busy processes."""
    done: list[Started] = []
    for number in range(starts):
        with TemporaryDirectory() as folder, _busy(loops):
            done.append(_start(cycles, Path(folder), bare, overrides))
        tell(f"{number + 1}/{starts}: {done[-1].picked} of {cycles} in {done[-1].wall_s:.0f} s {done[-1].failure}")
    walls_s = [one.wall_s for one in done]
    return {
        "starts": starts,
        "succeeded": sum(not one.failure for one in done),
        "cycles_each": cycles,
        "picks_succeeded": sum(one.picked for one in done),
        "busy_loops": loops,
        "cores": os.cpu_count(),
        "bare": bare,
        "wall_s": [round(wall_s, 1) for wall_s in walls_s],
        "wall_s_median": round(float(np.median(walls_s)), 1),
        "failures": [one.failure for one in done if one.failure],
        "unreadable": [why for one in done for why in one.unreadable],
    }


@contextmanager
def _busy(loops: int) -> Iterator[None]:
    """So many processes that compute for ever, beside what happens inside."""
    running = [subprocess.Popen([sys.executable, "-c", _LOOP]) for _ in range(loops)]
    try:
        yield
    finally:
        for loop in running:
            loop.kill()
            loop.wait()


def _start(cycles: int, folder: Path, bare: bool, overrides: list[str]) -> Started:
    settings = [f"recording.folder={folder / 'recordings'}", *overrides]
    options = [word for one in settings for word in ("--set", one)]
    command = [sys.executable, "-m", "cell", "start", "--json", "--cycles", str(cycles), *options]
    began_s = time.monotonic()
    try:
        ended = subprocess.run(
            command, capture_output=True, text=True, timeout=_PATIENCE_S, check=False, env=_environment(folder, bare)
        )
    except subprocess.TimeoutExpired:
        return Started(0, _PATIENCE_S, f"not over after {_PATIENCE_S:.0f} s")
    said = [json.loads(line) for line in ended.stdout.splitlines()]
    picked = [one for one in said if one.get("result") == "SUCCESS"]
    wall_s = time.monotonic() - began_s
    troubles = [trouble(Path(one["recording"])) for one in said if "recording" in one]
    return Started(len(picked), wall_s, _failure(ended, said), tuple(why for why in troubles if why))


def _failure(ended: subprocess.CompletedProcess[str], said: list[dict[str, Any]]) -> str:
    """Return why the start failed: the first pick that did, or an error; or else what the cell said last."""
    if ended.returncode == 0:
        return ""
    reasons = [f"{one['code']}: {one['reason']}" for one in said if one.get("result") != "SUCCESS"]
    return (reasons or ended.stderr.strip().splitlines()[-1:] or [f"exit code {ended.returncode}"])[0]


def _environment(folder: Path, bare: bool) -> dict[str, str]:
    """With the caches of modules and of shaders where nothing is yet."""
    empty = {"PYTHONPYCACHEPREFIX": str(folder / "modules"), "XDG_CACHE_HOME": str(folder / "shaders")}
    return {**os.environ, **(empty if bare else {})}
