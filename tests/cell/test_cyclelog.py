"""The record of a cycle on a disk that fails, blocks, lies or is slow: said as RECORDING, in time, and never lost."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.exceptions import McapError
from mcap.records import Message
from mcap.stream_reader import StreamReader

from bus import topics
from bus.codec import encode
from bus.codes import Code
from bus.errors import CycleFailure
from bus.fault_injection import Fault
from bus.messages import HandState
from bus.sample import Sample
from bus.topics import encoding_of
from cell.pick.record import BACKLOG_BYTES, CycleLog
from logs.mcap.fault_injection import FaultyDisk
from logs.mcap.recorder import Recorder

PATIENCE_S, OF_A_BUSY_MACHINE_S = 0.3, 60.0
"""With a disk that blocks for ever; with one that does not."""
HAND = Sample(
    topics.HAND_STATE.key,
    encoding_of(HandState),
    encode(HandState(stamp_ns=1, width_m=0.04, is_moving=False, is_homed=True)),
)


class Bench:
    """A cycle's log on a disk that can be spoiled."""

    def __init__(
        self,
        folder: Path,
        fault: Fault = Fault.NONE,
        backlog_bytes: int = BACKLOG_BYTES,
        patience_s: float = OF_A_BUSY_MACHINE_S,
    ) -> None:
        self.path = folder / "cycle.mcap"
        self.part = folder / "cycle.mcap.part"
        self.disk = FaultyDisk(fault, delay_s=0.01)
        self.log = CycleLog(self._open, self.path, patience_s, backlog_bytes=backlog_bytes)

    def _open(self) -> Recorder:
        return Recorder(self.path, metadata={"cycle_id": "one"}, clock=lambda: 1, under=self.disk.under)

    def flushed(self) -> None:
        """Wait until what was heard so far is in the file."""
        self.log.hear(HAND._replace(key="state"))  # of a state follows a flush
        self.until(lambda: self.part.exists() and messages(self.part) > 0)

    def refusal(self, act: Callable[[], None]) -> str:
        with pytest.raises(CycleFailure) as caught:
            act()
        assert caught.value.failure is Code.RECORDING
        return caught.value.text

    def has_failed(self) -> bool:
        try:
            self.log.check()
        except CycleFailure:
            return True
        return False

    def until(self, condition: Callable[[], bool]) -> None:
        give_up_s = time.monotonic() + 60
        while not condition():
            assert time.monotonic() < give_up_s
            time.sleep(0.01)


def messages(path: Path) -> int:
    """How many a linear reader finds, up to the tear."""
    count = 0
    try:
        with path.open("rb") as file:
            for record in StreamReader(file).records:
                count += isinstance(record, Message)
    except McapError:
        pass
    return count


def test_a_good_disk_keeps_everything(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.log.await_open()
    for _ in range(100):
        bench.log.hear(HAND)
    bench.log.close({"result": "SUCCESS"})
    assert messages(bench.path) == 100 and not bench.part.exists()


@pytest.mark.parametrize(("fault", "says"), [(Fault.OFF, "Input/output error"), (Fault.WRONG, "No space left")])
def test_a_disk_that_fails_is_noticed_and_what_was_written_stays(tmp_path: Path, fault: Fault, says: str) -> None:
    bench = Bench(tmp_path)
    bench.flushed()
    bench.disk.fault = fault
    bench.log.hear(HAND)
    assert says in bench.refusal(lambda: bench.log.close({}))
    assert says in bench.refusal(bench.log.check)
    assert messages(bench.part) == 1 and not bench.path.exists()


def test_a_disk_that_blocks_keeps_nobody_waiting_and_the_file_is_let_go_when_it_moves_again(tmp_path: Path) -> None:
    bench = Bench(tmp_path, Fault.STUCK, patience_s=PATIENCE_S)
    started_s = time.monotonic()
    assert "blocks" in bench.refusal(bench.log.await_open)
    assert "blocks" in bench.refusal(lambda: bench.log.close({}))
    assert time.monotonic() - started_s < 60, "the disk blocks for ever; the rest is a busy machine"
    bench.disk.fault = Fault.NONE
    bench.until(lambda: not bench.log.is_writing)


def test_a_disk_that_blocks_in_mid_cycle_is_noticed_by_the_next_stage(tmp_path: Path) -> None:
    bench = Bench(tmp_path, patience_s=PATIENCE_S)
    bench.flushed()
    bench.disk.fault = Fault.STUCK
    bench.log.hear(HAND)
    bench.until(bench.has_failed)
    assert "blocks" in bench.refusal(bench.log.check)
    bench.refusal(lambda: bench.log.close({}))
    bench.disk.fault = Fault.NONE
    bench.until(lambda: not bench.log.is_writing)
    assert messages(bench.part) >= 1


def test_a_disk_that_lies_is_found_out_when_the_file_is_closed(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.flushed()
    bench.disk.fault = Fault.GARBAGE
    bench.log.hear(HAND)
    assert "does not hold what was written" in bench.refusal(lambda: bench.log.close({}))
    assert bench.part.exists() and not bench.path.exists()


def test_a_slow_disk_is_waited_for(tmp_path: Path) -> None:
    bench = Bench(tmp_path, Fault.SLOW)
    bench.log.hear(HAND)
    bench.log.close({})
    assert messages(bench.path) == 1


def test_what_waits_for_a_slow_disk_is_bounded(tmp_path: Path) -> None:
    bench = Bench(tmp_path, Fault.STUCK, backlog_bytes=1000)
    for _ in range(100):
        bench.log.hear(HAND)
    assert "too slow" in bench.refusal(bench.log.check)
    bench.disk.fault = Fault.NONE
    bench.refusal(lambda: bench.log.close({}))
    bench.until(lambda: not bench.log.is_writing)


def test_what_no_topic_carries_is_left_out(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.log.hear(HAND._replace(encoding="application/json;stranger"))
    bench.log.hear(HAND)
    bench.log.close({})
    assert messages(bench.path) == 1
