"""What is written comes back; what is torn, damaged or foreign is said to be so."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import McapRecord
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory

from bus.errors import RecordingError
from bus.messages import Frame
from logs.mcap.reader import read_cycle
from logs.mcap.recorder import Recorder, ensure_space
from tests.logs.listed import listed

Record = Callable[..., Path]


def test_a_cycle_comes_back_whole(record: Record, frame: Frame) -> None:
    cycle = read_cycle(record())
    assert list(cycle.stages) == ["capture", "detect", "plan", "execute", "verify"]
    assert cycle.observation is not None and cycle.after is not None and cycle.result is not None
    assert cycle.observation.frame.stamp_ns == frame.stamp_ns
    assert cycle.after.frame.stamp_ns == cycle.after.view.stamp_ns == frame.stamp_ns + 1
    assert cycle.result.result == cycle.metadata["result"] == "SUCCESS"
    assert cycle.station["cell_id"] == "sim" and len(cycle.states) == len(cycle.hand) == 1


def test_a_cycle_that_ended_early_comes_back_with_its_failure(record: Record) -> None:
    cycle = read_cycle(record("detect"))
    assert list(cycle.stages) == ["capture", "detect"]
    failure = cycle.stages["detect"].failure
    assert failure is not None and failure.code == "NO_GRASP" and cycle.after is None


def test_plain_mcap_reads_schemas_metadata_and_attachments(record: Record) -> None:
    with record().open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        names = {(channel.topic, schema.name) for schema, channel, _ in reader.iter_messages() if schema}
        (color, *_) = [decoded for *_, decoded in reader.iter_decoded_messages(topics=["/camera/color"])]
        (state,) = [json.loads(message.data) for *_, message in reader.iter_messages(topics=["/state"])]
        assert [attachment.name for attachment in reader.iter_attachments()] == ["station.json"]
        assert {metadata.name for metadata in reader.iter_metadata()} == {"run", "result"}
    assert ("/camera/depth", "foxglove.RawImage") in names and ("/cycle/plan", "vlad.StageRecord.PickPlan") in names
    assert color.frame_id == "color" and state["state"] == "Execute"


def test_until_it_is_closed_it_is_a_part_that_only_the_group_reads(tmp_path: Path) -> None:
    path = tmp_path / "day" / "cycle.mcap"
    recorder = Recorder(path, metadata={}, clock=lambda: 1)
    part = path.with_name("cycle.mcap.part")
    assert part.is_file() and not path.exists() and part.stat().st_mode & 0o777 == 0o640
    with pytest.raises(RecordingError, match="not finished"):
        read_cycle(part)
    assert recorder.close({}) == recorder.close({}) == path
    assert path.is_file() and not part.exists()


_WRITE_AND_DIE = """
import os, signal, sys
from pathlib import Path
from bus.codec import encode
from bus.messages import HandState
from logs.mcap.recorder import Recorder
recorder = Recorder(Path(sys.argv[1]), metadata={}, clock=lambda: 1)
for n in range(200):
    message = HandState(stamp_ns=n, width_m=0.04, is_moving=False, is_homed=True)
    recorder.write("hand/state", "application/json;vlad.HandState", encode(message), log_time_ns=n)
    if n == 149:
        recorder.flush()
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_process_loses_nothing_that_was_flushed(tmp_path: Path) -> None:
    path = tmp_path / "cycle.mcap"
    done = subprocess.run([sys.executable, "-c", _WRITE_AND_DIE, str(path)], check=False)
    assert done.returncode == -signal.SIGKILL
    with path.with_name("cycle.mcap.part").open("rb") as file:
        found = [record for record in _until_torn(StreamReader(file)) if type(record).__name__ == "Message"]
    assert len(found) >= 150


def _until_torn(reader: StreamReader) -> list[McapRecord]:
    records: list[McapRecord] = []
    iterator = iter(reader.records)
    while True:
        try:
            records.append(next(iterator))
        except (McapError, EOFError, StopIteration):  # the tear
            return records


def test_a_disk_that_cannot_be_written_is_a_recording_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(RecordingError, match="file"):
        Recorder(tmp_path / "file" / "cycle.mcap", metadata={}, clock=lambda: 1)
    with pytest.raises(RecordingError, match=r"MB are free.*Delete or move"):
        ensure_space(tmp_path, 1e12)
    ensure_space(tmp_path / "new" / "folder", 0.0)


@pytest.mark.skipif(os.geteuid() != 0, reason="mounting a tiny disk needs root")
def test_a_full_disk_is_a_recording_error(tmp_path: Path) -> None:
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "none", str(tmp_path)], check=False).returncode:
        pytest.skip("this machine lets nobody mount a tmpfs")
    try:
        recorder = Recorder(tmp_path / "cycle.mcap", metadata={}, clock=lambda: 1)
        recorder.attach("small", "text/plain", b"fits")
        with pytest.raises(RecordingError, match="No space left"):
            recorder.attach("noise", "application/octet-stream", random.Random(0).randbytes(200_000))
            recorder.flush()
        recorder.abandon()
        recorder.abandon()
    finally:
        subprocess.run(["umount", "-l", str(tmp_path)], check=True)


def test_no_damage_goes_unnoticed_and_none_crashes(record: Record, tmp_path: Path) -> None:
    """Any single flipped byte or cut: a RecordingError, or exactly the same cycle."""
    whole = record().read_bytes()
    true = read_cycle(record())
    rng = random.Random(1)
    refused = 0
    for trial in range(40):
        damaged = bytearray(whole)
        where = rng.randrange(len(whole))
        if trial % 2:
            damaged[where] ^= 1 << rng.randrange(8)
        else:
            del damaged[where:]
        path = tmp_path / "damaged.mcap"
        path.write_bytes(damaged)
        try:
            read = read_cycle(path)
        except RecordingError as error:
            refused += 1
            assert "\n" not in str(error)
        else:
            assert [stage.model_dump_json() for stage in read.stages.values()] == [
                stage.model_dump_json() for stage in true.stages.values()
            ]
    assert refused >= 20, "at least every cut file is refused"


def test_the_index_lists_newest_first_and_hides_nothing(record: Record, tmp_path: Path) -> None:
    record("plan", name="20260101T000000001")
    record(name="20260102T000000001")
    (tmp_path / "20260103T000000001.mcap.part").write_bytes(b"")
    (tmp_path / "20260104T000000001.mcap").write_bytes(b"not an MCAP")
    entries = [(entry.cycle_id, entry.result) for entry in listed(tmp_path)]
    assert entries == [
        ("20260104T000000001", "DAMAGED"),
        ("20260103T000000001", "TORN"),
        ("20260102T000000001", "SUCCESS"),
        ("20260101T000000001", "FAILED"),
    ]
    with pytest.raises(RecordingError, match="no folder"):
        listed(tmp_path / "absent")
