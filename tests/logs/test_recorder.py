"""A recording is plain MCAP that any tool reads, keeps what was flushed, and says when the disk fails."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import threading
from collections.abc import Iterable
from pathlib import Path

import pytest
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Channel, Schema
from mcap.records import Message as McapMessage
from mcap_protobuf.decoder import DecoderFactory

from bus import topics
from bus.codec import encode
from bus.errors import BadPayload, RecordingError
from bus.messages import Frame, HandState
from bus.sensor_codec import frame_to_wire
from bus.topics import encoding_of
from logs.mcap.recorder import PART, Recorder, ensure_space

NOW_NS = 1_700_000_000_000_000_000
HAND = HandState(stamp_ns=1, width_m=0.04, is_moving=False, is_homed=True)
AS_HAND = encoding_of(HandState)


def _recorder(path: Path) -> Recorder:
    return Recorder(path, metadata={"cycle_id": "one", "seed": "7"}, clock=lambda: NOW_NS)


def _say(recorder: Recorder, count: int) -> None:
    for n in range(count):
        message = HAND.model_copy(update={"stamp_ns": n})
        recorder.write("hand/state", AS_HAND, encode(message), log_time_ns=NOW_NS + n)


def _stamps(readable: Iterable[tuple[Schema | None, Channel, McapMessage]]) -> list[int]:
    """Stamps of the hand states up to the tear, if there is one."""
    found: list[int] = []
    try:
        for _, _, message in readable:
            found.append(json.loads(message.data)["stamp_ns"])
    except (McapError, EOFError):  # the tear
        pass
    return found


def test_sensor_data_comes_back_as_foxglove_messages(tmp_path: Path, frame: Frame) -> None:
    with _recorder(tmp_path / "cycle.mcap") as recorder:
        for topic in topics.FRAME_PARTS:
            payload = frame_to_wire(frame)[topic.key]
            recorder.write(topic.key, encoding_of(topic.says), payload, log_time_ns=frame.stamp_ns)
    with recorder.path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        seen = {
            channel.topic: (schema, message, said) for schema, channel, message, said in reader.iter_decoded_messages()
        }
    assert set(seen) == {f"/{topic.key}" for topic in topics.FRAME_PARTS}
    for topic in topics.FRAME_PARTS:
        schema, message, said = seen[f"/{topic.key}"]
        assert schema is not None and (schema.name, schema.encoding) == (topic.says.DESCRIPTOR.full_name, "protobuf")
        assert said.SerializeToString() == message.data == frame_to_wire(frame)[topic.key]
        assert message.log_time == message.publish_time == frame.stamp_ns
    depth = seen["/camera/depth"][2]
    assert (depth.width, depth.height, depth.encoding) == (80, 72, "16UC1")


def test_our_own_messages_come_back_as_json_with_their_schema(tmp_path: Path) -> None:
    with _recorder(tmp_path / "cycle.mcap") as recorder:
        _say(recorder, 3)
    with recorder.path.open("rb") as file:
        found = list(make_reader(file, validate_crcs=True).iter_messages())
    assert [message.sequence for *_, message in found] == [1, 2, 3]
    assert [message.log_time - NOW_NS for *_, message in found] == [0, 1, 2]
    schema, channel, message = found[0]
    assert schema is not None and (schema.name, schema.encoding) == ("vlad.HandState", "jsonschema")
    assert (channel.topic, channel.message_encoding) == ("/hand/state", "json")
    assert json.loads(schema.data) == HandState.model_json_schema()
    assert set(json.loads(message.data)) == set(json.loads(schema.data)["properties"])


def test_metadata_and_attachments_are_stored_as_given(tmp_path: Path) -> None:
    recorder = _recorder(tmp_path / "cycle.mcap")
    recorder.attach("station.json", "application/json", b'{"cell_id": "sim"}')
    recorder.close({"result": "SUCCESS"})
    with recorder.path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert {entry.name: entry.metadata for entry in reader.iter_metadata()} == {
            "run": {"cycle_id": "one", "seed": "7"},
            "result": {"result": "SUCCESS"},
        }
        (attachment,) = reader.iter_attachments()
    assert (attachment.name, attachment.media_type) == ("station.json", "application/json")
    assert (attachment.data, attachment.log_time) == (b'{"cell_id": "sim"}', NOW_NS)


def test_an_error_that_ends_the_recording_is_in_its_result(tmp_path: Path) -> None:
    with pytest.raises(BadPayload, match="application/x-unknown"), _recorder(tmp_path / "cycle.mcap") as recorder:
        recorder.write("hand/state", "application/x-unknown", b"", log_time_ns=1)
    with (tmp_path / "cycle.mcap").open("rb") as file:
        result = {entry.name: entry.metadata for entry in make_reader(file).iter_metadata()}["result"]
    assert "application/x-unknown" in result["error"]


def test_closing_twice_changes_nothing(tmp_path: Path) -> None:
    recorder = _recorder(tmp_path / "new" / "cycle.mcap")
    part = recorder.path.with_name(recorder.path.name + PART)
    _say(recorder, 1)
    assert part.is_file() and not recorder.path.exists()
    recorder.close({"result": "SUCCESS"})
    content = recorder.path.read_bytes()
    recorder.close({"result": "FAILED"})
    assert recorder.path.read_bytes() == content and not part.exists()
    assert recorder.path.stat().st_mode & 0o777 == 0o640


def test_a_closed_recording_was_read_back_from_the_disk_and_not_from_memory(tmp_path: Path) -> None:
    recorder = _recorder(tmp_path / "cycle.mcap")
    recorder.attach("noise", "application/octet-stream", random.Random(0).randbytes(1 << 20))
    before_bytes = _read_from_disk_bytes()
    size = recorder.close({}).stat().st_size
    if _is_in_memory(tmp_path):
        pytest.skip("this folder's file system has no disk")
    assert _read_from_disk_bytes() - before_bytes >= size > 1 << 20


def _read_from_disk_bytes() -> int:
    """Return how much the kernel fetched from storage for this process so far."""
    with Path("/proc/self/io").open() as file:
        return next(int(line.split()[1]) for line in file if line.startswith("read_bytes"))


def _is_in_memory(folder: Path) -> bool:
    done = subprocess.run(["stat", "-f", "-c", "%T", str(folder)], capture_output=True, text=True, check=True)
    return done.stdout.strip() in ("tmpfs", "ramfs")


def test_threads_may_write_at_once(tmp_path: Path) -> None:
    recorder = _recorder(tmp_path / "cycle.mcap")
    threads = [threading.Thread(target=_say, args=(recorder, 200)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    recorder.close({})
    with recorder.path.open("rb") as file:
        found = [message.sequence for *_, message in make_reader(file, validate_crcs=True).iter_messages()]
    assert sorted(found) == list(range(1, 801))


# --- what was flushed stays -------------------------------------------------------------------------------------------


def test_what_was_flushed_is_there_while_the_recording_goes_on(tmp_path: Path) -> None:
    recorder = _recorder(tmp_path / "cycle.mcap")
    part = recorder.path.with_name(recorder.path.name + PART)
    for round_number in (1, 2, 3):
        _say(recorder, 10)
        recorder.flush()
        with part.open("rb") as file:
            assert len(_stamps(NonSeekingReader(file).iter_messages(log_time_order=False))) == 10 * round_number
    recorder.close({})


_WRITE_AND_WAIT = """
import sys
from pathlib import Path
from bus.codec import encode
from bus.messages import HandState
from logs.mcap.recorder import Recorder
recorder = Recorder(Path(sys.argv[1]), metadata={}, clock=lambda: 1)
for n in range(int(sys.argv[2])):
    message = HandState(stamp_ns=n, width_m=0.04, is_moving=False, is_homed=True)
    recorder.write("hand/state", "application/json;vlad.HandState", encode(message), log_time_ns=n)
recorder.flush()
print("flushed", flush=True)
sys.stdin.read()
"""


def test_a_killed_process_leaves_every_flushed_message(tmp_path: Path) -> None:
    path, count = tmp_path / "cycle.mcap", 500
    with subprocess.Popen(
        [sys.executable, "-c", _WRITE_AND_WAIT, str(path), str(count)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None and process.stdout.readline() == b"flushed\n"
        process.send_signal(signal.SIGKILL)
        assert process.wait(timeout=60) == -signal.SIGKILL
    assert not path.exists()
    with path.with_name(path.name + PART).open("rb") as file:
        assert _stamps(NonSeekingReader(file).iter_messages(log_time_order=False)) == list(range(count))


# --- the disk fails ---------------------------------------------------------------------------------------------------


@pytest.fixture
def full(tmp_path: Path) -> Recorder:
    """A recorder whose disk takes nothing: its file is /dev/full."""
    path = tmp_path / "cycle.mcap"
    path.with_name(path.name + PART).symlink_to("/dev/full")
    recorder = _recorder(path)
    _say(recorder, 10)
    return recorder


def test_a_flush_to_a_full_disk_is_a_recording_error(full: Recorder) -> None:
    with pytest.raises(RecordingError, match="No space left") as failure:
        full.flush()
    assert str(full.path) in failure.value.text and failure.value.advice
    full.abandon()


def test_a_recording_that_cannot_be_finished_does_not_get_its_name(full: Recorder) -> None:
    with pytest.raises(RecordingError, match="No space left"):
        full.close({"result": "SUCCESS"})
    full.abandon()
    assert not full.path.exists()


def test_a_folder_that_cannot_be_made_is_a_recording_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(RecordingError, match="Not a directory"):
        _recorder(tmp_path / "file" / "day" / "cycle.mcap")
    with pytest.raises(RecordingError, match="Cannot record"):
        ensure_space(tmp_path / "file" / "day", 0.0)


def test_a_folder_that_may_not_be_written_is_refused_before_the_cycle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: not (path == tmp_path and mode & os.W_OK))  # also for root
    with pytest.raises(RecordingError, match="Nothing can be written to") as failure:
        ensure_space(tmp_path, 0.0)
    assert "recording.folder" in failure.value.advice


def test_too_little_space_is_refused_with_figures_and_advice(tmp_path: Path) -> None:
    ensure_space(tmp_path / "day", 0.0)
    assert (tmp_path / "day").is_dir()
    with pytest.raises(RecordingError, match=r"Only \d+ MB are free in .*; recording needs 1000000000 MB") as failure:
        ensure_space(tmp_path / "day", 1e9)
    assert "recording.folder" in failure.value.advice and "recording.keep_gb" in failure.value.advice


def test_what_another_process_writes_is_not_emptied(tmp_path: Path) -> None:
    recorder = _recorder(tmp_path / "cycle.mcap")
    recorder.flush()
    part = tmp_path / "cycle.mcap.part"
    size = part.stat().st_size
    with pytest.raises(RecordingError, match="Cannot record"):
        _recorder(tmp_path / "cycle.mcap")
    assert part.stat().st_size == size > 0
    recorder.close({})


@pytest.mark.parametrize("umask", [0o000, 0o077])
def test_a_recording_is_the_groups_to_read_and_nobody_elses(tmp_path: Path, umask: int) -> None:
    before = os.umask(umask)
    try:
        path = _recorder(tmp_path / "cycle.mcap").close({})
    finally:
        os.umask(before)
    assert path.stat().st_mode & 0o777 == 0o640
