"""A door whose event loop stands still ends; no other server may be in this process, it would end, too."""

from __future__ import annotations

import asyncio
import queue
import time
from contextlib import closing
from functools import partial
from pathlib import Path

import pytest

from bus.clock import WALL_CLOCK
from bus.sample import Sample
from bus.threads import handled_by
from cell.http.door import Door
from cell.nodes.loop_watch import LoopWatch
from tests.cell.http_bench import FakeCell, door_of, served


def test_a_loop_that_stands_still_is_a_defect() -> None:
    """It would notice no client's end, while the threads still say that their leases are attended."""
    defects: queue.SimpleQueue[str] = queue.SimpleQueue()

    async def run() -> None:
        with handled_by(lambda _name, defect: defects.put(str(defect))), closing(LoopWatch(WALL_CLOCK, "test", 0.3)):
            await asyncio.sleep(0.5)
            assert defects.empty()
            time.sleep(0.8)
            assert "stands still" in defects.get(timeout=10)

    asyncio.run(run())


def test_the_loop_of_the_http_door_is_watched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cell.http.server.LoopWatch", partial(LoopWatch, stalled_s=0.3))
    monkeypatch.setattr(Door, "hear", lambda _door, _sample: time.sleep(0.8))
    defects: queue.SimpleQueue[str] = queue.SimpleQueue()
    cell = FakeCell()
    with handled_by(lambda _name, defect: defects.put(str(defect))), served(door_of(cell, tmp_path), cell):
        cell.said.put(Sample("state", "", b""))
        assert "stands still" in defects.get(timeout=10)
