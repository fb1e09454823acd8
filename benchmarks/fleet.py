"""Many light cells on one router, and a viewer that subscribes and asks as `cell fleet` does: the age of its data."""

from __future__ import annotations

import multiprocessing as mp
import threading
import time
from collections.abc import Callable
from multiprocessing.synchronize import Barrier, Event
from typing import Any

import numpy as np
import zenoh

from bus import topics
from bus.codec import decode
from bus.commands import CellHealth, CellState, Nothing
from bus.sample import Sample
from bus.secured import session_config
from bus.session import Bus

_CELLS_A_PROCESS = 10
_PERIOD_S = 0.1


class _Cell:
    """Says its state ten times a second, and answers for state and health; no arm, no camera."""

    def __init__(self, cell_id: str, endpoint: str) -> None:
        self._bus = Bus.join(cell_id, endpoint)
        self._bus.answer(topics.STATE_NOW, lambda _payload, _fields: _state(), worker="state")
        self._bus.answer(
            topics.HEALTH_NOW, lambda _payload, _fields: CellHealth(is_healthy=True, nodes={}), worker="state"
        )

    def say(self) -> None:
        self._bus.publish(topics.STATE, _state())

    def close(self) -> None:
        self._bus.close()


def _state() -> CellState:
    """``since_ns`` is when it was said, so that the receiver knows its age."""
    return CellState(
        state="Execute", stage="detect", cycle_id="0", since_ns=time.time_ns(), available=("stop",), reason=""
    )


def _run_cells(numbers: range, endpoint: str, ready: Barrier, ended: Event) -> None:
    """One process: its cells take turns, evenly over the period."""
    cells = [_Cell(f"cell{number}", endpoint) for number in numbers]
    ready.wait()
    due_s = time.monotonic()
    while not ended.is_set():
        for cell in cells:
            cell.say()
            due_s += _PERIOD_S / len(cells)
            time.sleep(max(0.0, due_s - time.monotonic()))
    for cell in cells:
        cell.close()


def run(cells: int, seconds: float, endpoint: str, tell: Callable[[str], None]) -> dict[str, Any]:
    """``cells`` on a router at ``endpoint`` for ``seconds``.

    Returns: age [ms] of every state when it was heard; rate_hz of one cell; how long asking all of them took [ms].
    """
    context = mp.get_context("spawn")  # zenoh does not survive a fork
    groups = [range(first, min(first + _CELLS_A_PROCESS, cells)) for first in range(0, cells, _CELLS_A_PROCESS)]
    ready, ended = context.Barrier(len(groups) + 1), context.Event()
    with zenoh.open(session_config("router", listen=[endpoint], connect=[], file=None)):
        workers = [context.Process(target=_run_cells, args=(group, endpoint, ready, ended)) for group in groups]
        for worker in workers:
            worker.start()
        ready.wait(120)
        tell(f"{cells} cells in {len(workers)} processes")
        try:
            return _watch(cells, seconds, endpoint)
        finally:
            ended.set()
            for worker in workers:
                worker.join(30)


def _watch(cells: int, seconds: float, endpoint: str) -> dict[str, Any]:
    ages_ms: list[float] = []
    hearing = threading.Event()

    def hear(heard: Sample) -> None:
        if hearing.is_set():
            ages_ms.append((time.time_ns() - decode(CellState, heard.payload).since_ns) * 1e-6)

    with Bus.join("*", endpoint) as bus:
        bus.subscribe(topics.STATE.key, hear)
        time.sleep(1.0)  # all have found each other
        hearing.set()
        time.sleep(seconds)
        hearing.clear()
        asked_s = time.monotonic()
        seen = bus.survey(topics.STATE_NOW, Nothing(), timeout_s=5.0)
        survey_ms = (time.monotonic() - asked_s) * 1e3
    return {
        "cells": cells,
        "seen": len(seen),
        "heard": len(ages_ms),
        "rate_hz": len(ages_ms) / seconds / cells,
        "state_age_ms": {
            name: float(np.percentile(ages_ms, q)) for name, q in (("p50", 50), ("p99", 99), ("max", 100))
        },
        "survey_ms": survey_ms,
    }
