"""A torn recording becomes whole with everything that was flushed; nothing else is touched."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.reader import make_reader

from bus.codec import encode
from bus.errors import RecordingError
from bus.messages import HandState
from bus.topics import encoding_of
from logs.mcap.reader import read_cycle
from logs.mcap.recorder import Recorder
from logs.mcap.recover import StillWritten, recover, recover_leftovers
from tests.logs.listed import listed

Record = Callable[..., Path]
AS_HAND = encoding_of(HandState)


def _torn(path: Path, flushed: int, more: int = 0, cut: int | None = None) -> Path:
    """A ``.part`` as a killed process leaves it: ``flushed`` messages in chunks of ten, then part of one more chunk."""
    recorder = Recorder(path, metadata={"cycle_id": path.stem, "schema": "2"}, clock=lambda: 1)
    recorder.attach("station.json", "application/json", b"{}")
    rng = random.Random(0)
    part = path.with_name(path.name + ".part")
    for n in range(flushed + more):
        hand = HandState(stamp_ns=n, width_m=rng.random(), is_moving=False, is_homed=True)
        recorder.write("hand/state", AS_HAND, encode(hand), log_time_ns=n)
        if n < flushed and n % 10 == 9:
            recorder.flush()
            end = part.stat().st_size
    if more:
        recorder.flush()
    recorder.abandon()
    if cut is not None:
        part.write_bytes(part.read_bytes()[: end + cut])
    return part


def _messages(path: Path) -> int:
    with path.open("rb") as file:
        return sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages())


def test_a_torn_recording_gets_its_name_and_keeps_what_was_flushed(tmp_path: Path) -> None:
    part = _torn(tmp_path / "one.mcap", flushed=50)
    done = recover(part)
    assert (done.messages, done.lost, done.ended, done.path) == (50, False, "torn", str(tmp_path / "one.mcap"))
    assert not part.exists() and _messages(tmp_path / "one.mcap") == 50
    assert [path.name for path in tmp_path.iterdir()] == ["one.mcap"]
    cycle = read_cycle(tmp_path / "one.mcap")
    assert cycle.result is None and len(cycle.hand) == 50
    assert (cycle.metadata["result"], cycle.metadata["recovered"]) == ("INTERRUPTED", "yes")
    (entry,) = listed(tmp_path)
    assert entry.result == "INTERRUPTED" and "ends in the middle" in entry.reason


@pytest.mark.parametrize("cut", [1, 9, 40, 70, 500])
def test_a_tear_anywhere_in_the_last_chunk_costs_nothing_before_it(tmp_path: Path, cut: int) -> None:
    done = recover(_torn(tmp_path / "one.mcap", flushed=20, more=20, cut=cut))
    assert done.messages == 20 and not done.lost
    assert _messages(Path(done.path)) == done.messages


def test_the_last_stage_and_a_result_survive(record: Record) -> None:
    whole = record()
    content = whole.read_bytes()
    with whole.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    last = max(summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset)
    part = whole.with_name(whole.name + ".part")
    part.write_bytes(content[: last.chunk_start_offset + last.chunk_length])
    true = read_cycle(whole)
    whole.unlink()
    recover(part)
    read = read_cycle(whole)
    assert read.result == true.result and list(read.stages) == list(true.stages)


def test_a_damaged_chunk_is_left_out_and_said_to_be_lost(tmp_path: Path) -> None:
    part = _torn(tmp_path / "one.mcap", flushed=50)
    content = bytearray(part.read_bytes())
    with part.open("rb"):
        content[content.index(b"\x28\xb5\x2f\xfd", len(content) // 2) + 40] ^= 0xFF
    part.write_bytes(content)
    done = recover(part)
    assert (done.messages, done.losses.damaged, done.lost) == (40, 1, True)
    assert part.exists(), "what is damaged is kept: somebody may read more of it"


def test_a_cut_off_finished_recording_is_recovered_beside_itself(record: Record) -> None:
    path = record()
    content = path.read_bytes()
    path.write_bytes(content[: content.index(b"\x28\xb5\x2f\xfd") + 20_000])  # within the first chunk
    done = recover(path)
    assert done.lost and done.ended == "torn" and done.path.endswith(".recovered.mcap") and path.exists()
    assert read_cycle(Path(done.path)).result is None


def test_a_whole_recording_comes_back_equal(record: Record) -> None:
    path = record()
    done = recover(path)
    assert done.ended == "finished" and not done.lost
    read, true = read_cycle(Path(done.path)), read_cycle(path)
    assert [stage.model_dump_json() for stage in read.stages.values()] == [
        stage.model_dump_json() for stage in true.stages.values()
    ]
    assert read.metadata["result"] == "SUCCESS"


def test_what_is_being_written_is_left_alone(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "one.mcap", metadata={"cycle_id": "one"}, clock=lambda: 1)
    recorder.flush()
    with pytest.raises(StillWritten, match="is being written"):
        recover(tmp_path / "one.mcap.part")
    assert list(recover_leftovers(tmp_path)) == []
    recorder.close({})
    assert (tmp_path / "one.mcap").is_file()


def test_leftovers_are_found_in_every_day_and_one_bad_one_stops_nothing(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "bad.mcap.part").write_bytes(b"no MCAP")
    _torn(tmp_path / "b" / "good.mcap", flushed=10)
    bad, good = recover_leftovers(tmp_path)
    assert isinstance(bad, RecordingError) and "nothing that can be recovered" in bad.text
    assert not isinstance(good, RecordingError) and good.messages == 10
    assert list(recover_leftovers(tmp_path / "absent")) == []


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    part = _torn(tmp_path / "one.mcap", flushed=10)
    (tmp_path / "one.mcap").write_bytes(b"mine")
    with pytest.raises(RecordingError, match="already there"):
        recover(part)
    assert (tmp_path / "one.mcap").read_bytes() == b"mine"
    with pytest.raises(RecordingError, match="no recording"):
        recover(tmp_path / "absent.mcap")
