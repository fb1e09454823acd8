"""Whatever bytes a file of the recordings' folder holds: it is read, or said to be damaged; in bounded work."""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer

from bus import topics
from bus.codec import encode
from bus.commands import CellState
from bus.errors import RecordingError
from bus.messages import Attempt, CycleResult, HandState
from bus.topics import encoding_of
from cell.replay.republish import payloads
from logs.mcap.index import read_entry, read_metadata
from logs.mcap.reader import read_cycle
from logs.mcap.recorder import Recorder
from logs.mcap.recover import recover
from logs.report.day_report import write_cycle, write_day
from tests.logs.listed import listed

CYCLE_ID = "20260101T000000000"
CHUNK_AT = struct.Struct("<BQQQQII")
"""A chunk's head up to the length of its compression's name."""


def _said() -> Iterator[tuple[str, str, bytes]]:
    result = CycleResult(
        cycle_id=CYCLE_ID,
        object="box",
        result="SUCCESS",
        code=None,
        reason="Held.",
        stages={},
        wall_s=1.0,
        recording="",
    )
    state = CellState(state="Execute", stage="", cycle_id=CYCLE_ID, since_ns=1, available=(), reason="")
    hand = HandState(stamp_ns=1, width_m=0.03, is_moving=False, is_homed=True)
    for topic, message in (
        (topics.ATTEMPT, Attempt(cycle_id=CYCLE_ID)),
        (topics.STATE, state),
        *[(topics.HAND_STATE, hand)] * 20,
        (topics.RESULT, result),
    ):
        yield topic.key, encoding_of(topic.says), encode(message)


def _recorder(path: Path, station: bytes = b'{"cell_id": "sim"}') -> Recorder:
    recorder = Recorder(path, metadata={"cycle_id": CYCLE_ID, "schema": "3"}, clock=lambda: 1)
    recorder.attach("station.json", "application/json", station)
    for number, (key, encoding, payload) in enumerate(_said()):
        recorder.write(key, encoding, payload, log_time_ns=number)
        if number == 10:
            recorder.flush()
    return recorder


def _written(path: Path, station: bytes = b'{"cell_id": "sim"}') -> bytes:
    return _recorder(path, station).close({"result": "SUCCESS"}).read_bytes()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("foreign")


@pytest.fixture(scope="module")
def whole(folder: Path) -> bytes:
    return _written(folder / "whole.mcap")


def _try_everything(folder: Path, content: bytes) -> None:
    """Every reader of files gives something or its one error."""
    path = folder / "any.mcap"
    path.write_bytes(content)
    for read in (read_cycle, read_metadata, recover, lambda path: list(payloads(path))):
        with suppress(RecordingError):
            read(path)
    (folder / "any.recovered.mcap").unlink(missing_ok=True)
    entry = read_entry(path)
    assert entry.result != "DAMAGED" or entry.reason.isprintable()


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(folder: Path, content: bytes) -> None:
    _try_everything(folder, content)
    _try_everything(folder, b"\x89MCAP0\r\n" + content)


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_a_recording_with_any_bytes_in_it_is_read_or_refused(folder: Path, whole: bytes, data: st.DataObject) -> None:
    at = data.draw(st.integers(0, len(whole) - 1))
    until = data.draw(st.integers(at, min(len(whole), at + 40)) | st.just(len(whole)))
    numbers = st.sampled_from([0, 1, 255, 2**31, 2**32 - 1, 2**63, 2**64 - 1]).map(
        lambda value: struct.pack("<Q", value)
    )
    between = data.draw(st.binary(max_size=12) | numbers | st.just(bytes(1000)) | st.just(whole[:300]))
    _try_everything(folder, whole[:at] + between + whole[until:])


STATIONS = {
    "list": b"[1, 2]", "number": b"5", "null": b"null", "no JSON": b"{", "no text": b"\xff", "nothing": b"",
    "deep": b'{"a":' * 200 + b"1" + b"}" * 200, "very deep": b"[" * 100_000,
    "long number": b'{"a": ' + b"1" * 5000 + b"}", "half a character": b'{"a": "\\ud800"}',
}  # fmt: skip


@pytest.mark.parametrize("station", STATIONS.values(), ids=STATIONS.keys())
def test_a_station_that_is_none_makes_a_damaged_recording_and_the_day_has_its_page(
    tmp_path: Path, station: bytes
) -> None:
    _written(tmp_path / f"{CYCLE_ID}.mcap", station)
    good = tmp_path / "20260101T000000001.mcap"
    _written(good)
    with pytest.raises(RecordingError, match=r"station\.json"):
        read_cycle(tmp_path / f"{CYCLE_ID}.mcap")
    assert [entry.result for entry in listed(tmp_path)] == ["SUCCESS", "DAMAGED"]
    damaged = {path: why for path in tmp_path.glob("*.mcap") if (why := write_cycle(path))}
    assert len(damaged) == 1
    page = write_day(tmp_path, damaged).read_text()
    assert "DAMAGED" in page and "station.json" in page and 'href="20260101T000000001.html"' in page


@pytest.mark.parametrize("value", [5, "x", None, [], {"min_width_m": "wide"}, {"min_width_m": [1]}])
def test_a_station_of_any_content_gets_its_page(tmp_path: Path, value: object) -> None:
    station = {"verify": value, "perception": {"drift": value}, "cell_id": value}
    _written(tmp_path / f"{CYCLE_ID}.mcap", json.dumps(station).encode())
    assert write_cycle(tmp_path / f"{CYCLE_ID}.mcap") == ""


def test_a_name_that_is_no_text_is_shown_and_gets_its_page(tmp_path: Path) -> None:
    path = Path(f"{tmp_path}/caf\udce9.mcap")
    path.write_bytes(_written(tmp_path / "whole.mcap"))
    assert write_cycle(path) == "" and 'href="caf%E9.html"' in write_day(tmp_path).read_text()
    assert [json.dumps(entry.to_json()).isascii() for entry in listed(tmp_path)] == [True, True]
    assert all(entry.to_json()["recording"].isprintable() for entry in listed(tmp_path))


# --- bounded work -----------------------------------------------------------------------------------------------------


def _with_chunk(content: bytes, chunk: bytes) -> bytes:
    """The file with a chunk instead of its first one."""
    at = content.index(b"\x04\0\0\0zstd") - CHUNK_AT.size + 4
    (length,) = struct.unpack_from("<Q", content, at + 1)
    return content[:at] + chunk + content[at + 9 + length :]


def _chunk(size: int, data: bytes, compression: bytes = b"zstd") -> bytes:
    body = struct.pack("<QQQII", 0, 0, size, 0, len(compression)) + compression + struct.pack("<Q", len(data)) + data
    return struct.pack("<BQ", Opcode.CHUNK, len(body)) + body


def _bombs() -> dict[str, bytes]:
    zeros = zstandard.compress(bytes(160 << 20))
    no_size = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(160 << 20))
    return {
        "declares 3 GB": _chunk(3 << 30, zeros),
        "declares 16 EB": _chunk(2**64 - 1, zeros),
        "holds more than it says": _chunk(100, no_size),
        "says less, its frame more": _chunk(100, zeros),
        "many of the most": _chunk(128 << 20, zstandard.compress(bytes(128 << 20))) * 30,
    }


BOMBS = _bombs()


@pytest.mark.parametrize("bomb", BOMBS.values(), ids=BOMBS.keys())
def test_a_chunk_that_would_fill_the_memory_is_refused_at_once(tmp_path: Path, whole: bytes, bomb: bytes) -> None:
    path = tmp_path / "bomb.mcap"
    path.write_bytes(_with_chunk(whole, bomb))
    began_s = time.process_time()
    with pytest.raises(RecordingError):
        read_cycle(path)
    done = recover(path)
    assert done.lost and done.losses.damaged >= 1
    assert time.process_time() - began_s < 1.5


def test_the_zeros_that_a_power_cut_leaves_cost_nothing(tmp_path: Path) -> None:
    recorder = _recorder(tmp_path / "one.mcap")
    recorder.flush()
    recorder.abandon()
    part = tmp_path / "one.mcap.part"
    part.write_bytes(part.read_bytes() + bytes(4 << 20))
    began_s = time.process_time()
    done = recover(part)
    assert time.process_time() - began_s < 0.2
    assert (done.messages, done.lost) == (23, False)


def test_zeros_with_something_behind_them_are_a_loss(tmp_path: Path, whole: bytes) -> None:
    at = whole.index(b"\x04\0\0\0zstd") - CHUNK_AT.size + 4
    (tmp_path / "one.mcap.part").write_bytes(whole[:at] + bytes(4096) + whole[at:])
    assert recover(tmp_path / "one.mcap.part").losses.unknown_records == 1


@pytest.mark.parametrize("name", [b"gzip", b"zst", b"\xff\xfe\xfd\xfc", b"ZSTD"])
def test_a_compression_that_nobody_knows_is_counted_and_nothing_is_destroyed(
    tmp_path: Path, whole: bytes, name: bytes
) -> None:
    part = tmp_path / "one.mcap.part"
    known, unknown = b"\x04\0\0\0zstd", struct.pack("<I", len(name)) + name
    part.write_bytes(whole.replace(known, unknown) if len(name) == 4 else _with_chunk(whole, _chunk(9, b"x" * 9, name)))
    done = recover(part)
    assert done.lost and (done.losses.unknown_chunks or done.losses.damaged)
    assert done.to_json()["lost"] is True and part.exists()


@pytest.mark.parametrize("junk", [b"\x05" * 40, bytes(30), struct.pack("<BQ", 0x81, 3) + b"abc", b"x"])
def test_bytes_in_a_chunk_that_make_no_record_are_counted(tmp_path: Path, whole: bytes, junk: bytes) -> None:
    path = tmp_path / "one.mcap"
    path.write_bytes(_with_chunk(whole, _chunk(len(junk), junk, b"")))
    done = recover(path)
    assert done.losses.unknown_records == 1 and done.lost and "no record" in done.line()


def test_messages_whose_channel_was_lost_are_counted(tmp_path: Path, whole: bytes) -> None:
    """Of a finished file the summary names it again; of a torn one nothing does."""
    path, part = tmp_path / "one.mcap", tmp_path / "two.mcap.part"
    damaged = whole.replace(b"\x28\xb5\x2f\xfd", b"\x28\xb5\x2f\xfe", 1)
    path.write_bytes(damaged)
    part.write_bytes(damaged[:-60])
    finished, torn = recover(path), recover(part)
    assert finished.messages > 0 and finished.losses.orphans == 0
    assert torn.losses.orphans > 0 and torn.lost and part.exists()


@pytest.mark.parametrize("compression", list(CompressionType))
def test_files_of_other_writers_are_read_with_or_without_a_summary(
    tmp_path: Path, compression: CompressionType
) -> None:
    for whole_one in (True, False):
        path = tmp_path / f"{whole_one}.mcap"
        with path.open("wb") as file:
            writer = Writer(file, compression=compression, use_summary_offsets=whole_one, use_statistics=whole_one,
                            repeat_channels=whole_one, repeat_schemas=whole_one)  # fmt: skip
            writer.start()
            writer.add_metadata("run", {"cycle_id": CYCLE_ID, "result": "SUCCESS"})
            writer.add_attachment(1, 1, "station.json", "application/json", b"{}")
            for key, _, payload in _said():
                writer.add_message(writer.register_channel(f"/{key}", "json", 0), 1, payload, 1)
            writer.finish()  # type: ignore[no-untyped-call]
        assert read_entry(path).result == "SUCCESS"
        assert recover(path).messages == 23 and read_cycle(path).cycle_id == CYCLE_ID
