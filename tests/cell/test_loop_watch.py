"""A door whose event loop stands still ends; no other server may be in this process, it would end, too."""

from __future__ import annotations

import asyncio
import queue
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path

import pytest

from bus.clock import WallClock
from bus.sample import Sample
from bus.threads import handled_by
from cell.http.door import Door
from cell.nodes.loop_watch import LoopWatch
from tests.cell.http_bench import FakeCell, door_of, served

LOOK_S, STALLED_S = 0.01, 0.3


class Watched:
    """A running loop that is watched, by a clock that the test moves."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.defects: queue.SimpleQueue[str] = queue.SimpleQueue()

    @contextmanager
    def loop(self) -> Iterator[None]:
        clock = WallClock(lambda: self.now_s)
        with (
            handled_by(lambda _name, defect: self.defects.put(str(defect))),
            closing(LoopWatch(clock, "test", STALLED_S)),
        ):
            yield


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> Watched:
    monkeypatch.setattr("cell.nodes.loop_watch.LOOK_S", LOOK_S)
    return Watched()


def test_a_loop_that_stands_still_is_a_defect(watched: Watched) -> None:
    """It would notice no client's end, while the threads still say that their leases are attended."""

    async def run() -> None:
        with watched.loop():
            give_up_s = time.monotonic() + 60
            while watched.defects.empty():
                assert time.monotonic() < give_up_s
                watched.now_s += LOOK_S
                time.sleep(LOOK_S)
            assert watched.now_s > STALLED_S and "stands still" in watched.defects.get()

    asyncio.run(run())


def test_a_loop_that_turns_is_none_however_long_it_lives(watched: Watched) -> None:
    async def run() -> None:
        with watched.loop():
            for _ in range(50):
                watched.now_s += 2 * LOOK_S
                await asyncio.sleep(2 * LOOK_S)
            assert watched.now_s > 3 * STALLED_S and watched.defects.empty()

    asyncio.run(run())


def test_a_process_that_stood_still_as_a_whole_is_none(watched: Watched) -> None:
    async def run() -> None:
        with watched.loop():
            watched.now_s += 100.0
            time.sleep(5 * LOOK_S)  # the loop does not turn before the watch has looked
            await asyncio.sleep(5 * LOOK_S)
            assert watched.defects.empty()

    asyncio.run(run())


def test_the_loop_of_the_http_door_is_watched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cell.http.server.LoopWatch", partial(LoopWatch, stalled_s=0.3))
    goes_on = threading.Event()
    monkeypatch.setattr(Door, "hear", lambda _door, _sample: goes_on.wait(60))
    defects: queue.SimpleQueue[str] = queue.SimpleQueue()
    cell = FakeCell()
    with handled_by(lambda _name, defect: defects.put(str(defect))), served(door_of(cell, tmp_path), cell):
        cell.said.put(Sample("state", "", b""))
        try:
            assert "stands still" in defects.get(timeout=60)
        finally:
            goes_on.set()
