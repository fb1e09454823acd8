"""The record of a cycle is on the disk within 100 ms, at once after a state or a stage, and says when it cannot be."""

from __future__ import annotations

import io
import os
import threading
import time
from pathlib import Path
from typing import Any, BinaryIO

import pytest
from mcap.reader import make_reader

from bus import topics
from bus.codec import encode
from bus.codes import Code
from bus.commands import CellState
from bus.errors import CycleFailure
from bus.messages import HandState, ModelReply
from bus.sample import Sample
from bus.topics import encoding_of
from cell.pick.record import CycleLog
from logs.mcap.reader import read_cycle
from logs.mcap.recorder import Recorder
from logs.mcap.recover import recover

HAND = Sample(
    topics.HAND_STATE.key,
    encoding_of(HandState),
    encode(HandState(stamp_ns=1, width_m=0.04, is_moving=False, is_homed=True)),
)
STATE = Sample(
    topics.STATE.key,
    encoding_of(CellState),
    encode(CellState(state="Execute", stage="", cycle_id="one", since_ns=1, available=(), reason="")),
)


class Disk(io.BufferedWriter):
    """A disk that tells when it was flushed, and can be full or stand still."""

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file.detach())  # type: ignore[attr-defined]
        self.flushed = threading.Semaphore(0)
        self.goes_on = threading.Event()
        self.goes_on.set()
        self.is_full = False

    def write(self, data: object) -> int:
        self.goes_on.wait()
        if self.is_full:
            raise OSError(28, os.strerror(28))
        return super().write(data)  # type: ignore[arg-type]

    def flush(self) -> None:
        super().flush()
        self.flushed.release()


class Bench:
    """A log on such a disk."""

    def __init__(self, path: Path, **limits: Any) -> None:
        self.failures: list[CycleFailure] = []
        self.failed = threading.Event()
        self.disk: Disk | None = None
        self._path = path
        self.log = CycleLog(self._open, path, 30.0, on_failure=self._fail, **limits)
        self.log.await_open()
        assert self.disk is not None
        self.disk.flushed = threading.Semaphore(0)

    def _open(self) -> Recorder:
        metadata = {"cycle_id": "one", "schema": "2"}
        recorder = Recorder(self._path, metadata=metadata, clock=time.time_ns, under=self._under)
        recorder.attach("station.json", "application/json", b"{}")
        recorder.flush()
        return recorder

    def _under(self, file: BinaryIO) -> Disk:
        self.disk = Disk(file)
        return self.disk

    def _fail(self, failure: CycleFailure) -> None:
        self.failures.append(failure)
        self.failed.set()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "one.mcap"


@pytest.fixture
def bench(path: Path) -> Bench:
    return Bench(path)


def test_one_message_is_flushed_though_nothing_follows(bench: Bench) -> None:
    assert bench.disk is not None
    bench.log.hear(HAND)
    assert bench.disk.flushed.acquire(timeout=60)
    bench.log.close({})


def test_every_state_is_flushed_at_once(path: Path) -> None:
    bench = Bench(path, gather_s=60.0)
    assert bench.disk is not None
    for _ in range(3):
        bench.log.hear(HAND)
        bench.log.hear(STATE)
        assert bench.disk.flushed.acquire(timeout=60)
    bench.log.close({})
    assert len(read_cycle(bench.log.path).states) == 3


def test_a_full_disk_fails_the_cycle_once_and_what_was_flushed_stays(bench: Bench) -> None:
    assert bench.disk is not None
    bench.log.hear(STATE)
    assert bench.disk.flushed.acquire(timeout=60)
    bench.disk.is_full = True
    bench.log.hear(STATE)
    assert bench.failed.wait(60)
    bench.log.hear(STATE)
    with pytest.raises(CycleFailure, match="No space left"):
        bench.log.check()
    with pytest.raises(CycleFailure, match="No space left"):
        bench.log.close({"result": "SUCCESS"})
    assert [failure.failure for failure in bench.failures] == [Code.RECORDING]
    part = bench.log.path.with_name("one.mcap.part")
    assert recover(part).messages == 1 and len(read_cycle(bench.log.path).states) == 1


def test_a_disk_that_stands_still_fails_the_cycle_before_memory_does(path: Path) -> None:
    bench = Bench(path, backlog_bytes=10 * len(HAND.payload))
    assert bench.disk is not None
    bench.disk.goes_on.clear()
    for _ in range(12):
        bench.log.hear(HAND)
    assert [failure.failure for failure in bench.failures] == [Code.RECORDING]
    with pytest.raises(CycleFailure, match="too slow"):
        bench.log.check()
    bench.disk.goes_on.set()
    with pytest.raises(CycleFailure, match="too slow"):
        bench.log.close({})


def test_what_no_topic_says_is_left_out_and_stops_nothing(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    bench.log.hear(Sample("state", "application/x-stranger", b"?"))
    bench.log.hear(STATE)
    bench.log.close({})
    assert len(read_cycle(bench.log.path).states) == 1 and "not recorded on state" in caplog.text


def test_prompts_replies_and_pictures_are_files_of_their_own(bench: Bench) -> None:
    reply = ModelReply(step="render", model="painter", prompt="Paint.", text="Done.", image_png=b"png")
    bench.log.hear(Sample(topics.MODEL_REPLY.key, encoding_of(ModelReply), encode(reply)))
    bench.log.close({})
    with bench.log.path.open("rb") as file:
        found = {one.name: one.data for one in make_reader(file, validate_crcs=True).iter_attachments()}
    assert found == {
        "station.json": b"{}",
        "prompts/00-render.txt": b"Paint.",
        "replies/00-render.txt": b"Done.",
        "goal_images/00-render.png": b"png",
    }
