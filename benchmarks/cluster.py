"""The same replays by one process and by several, of which one is killed in the middle: how much faster, and equal?"""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable, Sequence
from functools import partial
from itertools import cycle, islice
from multiprocessing import active_children
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from cell.replay.folder import Judged, judge, recordings_below
from cell.replay.replay import Request
from cell.workers import LocalWorkers, WorkerLost, in_order

_ROUNDS = 3
_AS_IT_IS = Request.of([], None, None, live_models=False)


def run(folder: Path, recordings: int, workers: int, tell: Callable[[str], None]) -> dict[str, Any]:
    """Replay recordings, by turns by this process alone and by ``workers`` processes, which it starts each time.

    Args:
        folder: of the recordings; where there are fewer than ``recordings``, they are replayed several times.

    Returns:
        ``speedup_2``: time of the wall of one process, as a share of that of several: the median of three rounds, each
        of a third of them; ``rounds_s``: both of each round. ``equal``: also with one of them killed in the middle, all
        results are the same to the byte. ``lost``: those that are missing then. ``recordings``, ``workers``, ``load``.
    """
    paths = list(islice(cycle(recordings_below(folder)), recordings))
    with TemporaryDirectory() as name:
        copies = [_linked(Path(name), number, path) for number, path in enumerate(paths)]
        judge(copies[0], _AS_IT_IS)  # what is loaded at the first use is loaded
        rounds, alone = [], list[str]()
        for at in range(_ROUNDS):
            part = copies[at::_ROUNDS]
            one_s, said = _timed(part, LocalWorkers(1))
            several_s, again = _timed(part, LocalWorkers(workers))
            tell(f"{len(part)} recordings: {one_s:.1f} s alone, {several_s:.1f} s by {workers}")
            rounds.append((round(one_s, 2), round(several_s, 2)))
            alone += said
            if said != again:
                tell("they differ")
        killed = _with_a_death(copies, workers, tell)
    expected = [said for at in range(_ROUNDS) for said in killed[at::_ROUNDS]]
    return {
        "speedup_2": round(median(one_s / several_s for one_s, several_s in rounds), 2),
        "equal": alone == expected,
        "lost": sum("WORKER_LOST" in said for said in killed) + len(copies) - len(killed),
        "rounds_s": rounds,
        "recordings": len(copies),
        "workers": workers,
        "load": round(os.getloadavg()[0], 1),
    }


def _linked(folder: Path, number: int, path: Path) -> Path:
    link = folder / f"{number:04d}.mcap"
    link.symlink_to(path.absolute())
    return link


def _timed(paths: Sequence[Path], workers: LocalWorkers) -> tuple[float, list[str]]:
    began_s = time.perf_counter()
    said = [_said(found) for _, found in in_order(workers.run(partial(judge, request=_AS_IT_IS), paths))]
    return time.perf_counter() - began_s, said


def _with_a_death(paths: Sequence[Path], workers: int, tell: Callable[[str], None]) -> list[str]:
    """The results in the order of the paths, of workers one of which is killed after half of them."""
    found: dict[int, str] = {}
    for index, judged in LocalWorkers(workers).run(partial(judge, request=_AS_IT_IS), paths):
        found[index] = _said(judged)
        if len(found) == len(paths) // 2 and (pid := active_children()[0].pid):
            os.kill(pid, signal.SIGKILL)
            tell(f"killed {pid} after {len(found)}")
    return [found[index] for index in sorted(found)]


def _said(judged: Judged | WorkerLost) -> str:
    if isinstance(judged, WorkerLost):
        return f"{judged.code}: {judged}"
    return json.dumps([judged.verdict, judged.error, judged.stages, judged.fields, judged.said])
