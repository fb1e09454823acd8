"""Makes a torn or damaged recording whole again: everything that can still be read, in a file that is finished.

A process that was killed leaves a ``.part``: its chunks up to the last flush, and perhaps the beginning of one more,
which was never flushed; of that, the messages that are complete are kept too. A chunk whose checksum is wrong is left
out, and said to be lost.
"""

from __future__ import annotations

import fcntl
import os
import struct
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from bus.errors import RecordingError
from logs.mcapfile import McapFile
from logs.reader import DAMAGE, RECOVERED
from logs.recorder import PART

_HEAD = struct.Struct("<BQ")
_CHUNK_FIXED = 8 + 8 + 8 + 4  # start, end, uncompressed size, checksum; then the compression's name
_LENGTH = struct.Struct("<I")
_KINDS: dict[int, Any] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
}
_INTERRUPTED = {
    "result": "INTERRUPTED",
    "code": "",
    "reason": "The process that recorded this cycle ended in the middle of it.",
}


@dataclass(frozen=True)
class Recovered:
    """What became of one file.

    Attributes:
        source, path: the file, and the one that holds now what it held.
        messages: how many were kept. ``lost_chunks``: damaged parts of the file that were left out.
        ended: how the file ended: ``finished``, or ``torn`` as a killed process leaves it.
    """

    source: str
    path: str
    messages: int
    lost_chunks: int
    ended: str

    @property
    def lost(self) -> bool:
        """Something is missing that had been written: not only what was never flushed."""
        was_finished_once = not self.source.endswith(PART)
        return self.lost_chunks > 0 or (was_finished_once and self.ended == "torn")

    def to_json(self) -> dict[str, Any]:
        return {**asdict(self), "lost": self.lost}

    def line(self) -> str:
        """One line for a person."""
        lost = f", {self.lost_chunks} damaged parts lost" if self.lost_chunks else ", its end lost" if self.lost else ""
        return f"{self.source} was {self.ended}: {self.messages} messages kept{lost}, in {self.path}"


def recover(path: Path) -> Recovered:
    """Write what ``path`` holds into a finished file beside it. A ``.part`` gets its final name and is removed.

    Of any other file the result is ``NAME.recovered.mcap``; it, and a ``.part`` with damage inside, stay.
    Raises: RecordingError when there is nothing to recover, or its writer still lives.
    """
    target = _target(path)
    try:
        with path.open("rb") as source:
            _require_left(source, path)
            done = _copy(source, path, target)
        if path.name.endswith(PART) and not done.lost_chunks:
            path.unlink()
    except OSError as error:
        raise RecordingError(
            f"Cannot recover {path}: {error.strerror or error}.", "Check the disk's space and rights."
        ) from error
    return done


def recover_leftovers(folder: Path) -> Iterator[Recovered | RecordingError]:
    """Recover every ``.part`` below ``folder`` that nobody writes; what cannot be is given as its error."""
    for path in sorted(folder.rglob(f"*.mcap{PART}")) if folder.is_dir() else ():
        try:
            yield recover(path)
        except StillWritten:
            continue
        except RecordingError as error:
            yield error


class StillWritten(RecordingError):
    """The process that writes the file lives."""


def _target(path: Path) -> Path:
    if not path.is_file():
        raise RecordingError(f"There is no recording {path}.", "See `cell cycles`.")
    name = path.name.removesuffix(PART) if path.name.endswith(PART) else f"{path.stem}.recovered.mcap"
    target = path.with_name(name)
    if target.exists():
        raise RecordingError(f"{target} is already there.", f"Move it away if {path} holds more.")
    return target


def _require_left(source: IO[bytes], path: Path) -> None:
    try:
        fcntl.flock(source, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise StillWritten(f"{path} is being written.", "Wait until its cycle is over.") from error


# --- copying ----------------------------------------------------------------------------------------------------------


def _copy(source: IO[bytes], path: Path, target: Path) -> Recovered:
    """Into a temporary file that gets its name when it is whole."""
    salvage = _Salvage(source)
    unfinished = target.with_name(f".{target.name}.recovering")
    try:
        with unfinished.open("wb") as out:
            os.fchmod(out.fileno(), path.stat().st_mode & 0o777)
            writer = _Copy(McapFile(out))
            for record in salvage.records():
                writer.add(record)
            if not writer.messages and not writer.is_ours:
                raise RecordingError(
                    f"{path} holds nothing that can be recovered.", "It is no MCAP, or was torn before its first flush."
                )
            writer.finish(path.name, "finished" if salvage.is_finished else "torn", salvage.lost_chunks)
            out.flush()
            os.fsync(out.fileno())
        unfinished.rename(target)
    finally:
        unfinished.unlink(missing_ok=True)
    ended = "finished" if salvage.is_finished else "torn"
    return Recovered(str(path), str(target), writer.messages, salvage.lost_chunks, ended)


class _Copy:
    """Writes records as they were, under ids of its own."""

    def __init__(self, out: McapFile) -> None:
        self._out = out
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}
        self._has_result = False
        self.messages = 0
        self.is_ours = False

    def add(self, record: McapRecord) -> None:
        match record:
            case Schema() if record.id not in self._schemas:
                self._schemas[record.id] = self._out.schema(record.name, record.encoding, record.data)
            case Channel() if record.id not in self._channels and record.schema_id in self._schemas:
                schema_id = self._schemas[record.schema_id]
                self._channels[record.id] = self._out.channel(record.topic, record.message_encoding, schema_id)
            case Message() if record.channel_id in self._channels:
                channel_id = self._channels[record.channel_id]
                self._out.message(channel_id, record.log_time, record.data, record.publish_time, record.sequence)
                self.messages += 1
            case Attachment():
                self._out.attachment(record.log_time, record.name, record.media_type, record.data)
            case Metadata():
                self.is_ours = self.is_ours or record.name == "run"
                self._has_result = self._has_result or record.name == "result"
                self._out.metadata(record.name, record.metadata)
            case _:
                pass

    def finish(self, source: str, ended: str, lost_chunks: int) -> None:
        said = {} if self._has_result else _INTERRUPTED
        how = {RECOVERED: "yes", "recovered_from": source, "ended": ended, "lost_chunks": str(lost_chunks)}
        self._out.metadata("result", {**said, **how})
        self._out.finish()


class _Salvage:
    """Reads what can be read of ``source``, in order, and goes on behind a chunk that is damaged."""

    def __init__(self, source: IO[bytes]) -> None:
        self._source = source
        self.is_finished = False
        self.lost_chunks = 0

    def records(self) -> Iterator[McapRecord]:
        """Up to the end of the data section, or the tear."""
        if self._source.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            return
        while len(head := self._source.read(_HEAD.size)) == _HEAD.size:
            opcode, length = _HEAD.unpack(head)
            start = self._source.tell()
            left = os.fstat(self._source.fileno()).st_size - start
            body = self._source.read(min(length, left))
            if opcode == Opcode.CHUNK:
                yield from self._chunk(body, is_torn=length > left)
            elif length > left:
                return
            elif opcode == Opcode.DATA_END:
                self.is_finished = True
                return
            else:
                yield from self._one(opcode, body)

    def _one(self, opcode: int, body: bytes) -> Iterator[McapRecord]:
        try:
            records = list(_record(opcode, body))
        except DAMAGE:
            self.lost_chunks += 1
            return
        yield from records

    def _chunk(self, body: bytes, *, is_torn: bool) -> Iterator[McapRecord]:
        """The records of one chunk. Of a torn one, which was never flushed, as many as are complete."""
        try:
            records = list(_complete(_beginning(body) if is_torn else _content(body)))
        except DAMAGE:
            self.lost_chunks += not is_torn
            return
        yield from records


def _content(body: bytes) -> bytes:
    """What a whole chunk holds, its checksum looked at."""
    stream, length = get_chunk_data_stream(Chunk.read(_stream(body)), validate_crc=True)
    return stream.read(length)


def _beginning(body: bytes) -> bytes:
    """As much of a torn chunk as can be decompressed; nothing has a checksum here but zstd's own blocks."""
    (name_length,) = _LENGTH.unpack_from(body, _CHUNK_FIXED)
    name_end = _CHUNK_FIXED + _LENGTH.size + name_length
    data = body[name_end + 8 :]
    if body[name_end - name_length : name_end] != b"zstd":
        return b""
    return zstandard.ZstdDecompressor().decompressobj().decompress(data)


def _complete(content: bytes) -> Iterator[McapRecord]:
    """The complete records of a chunk's content."""
    start = 0
    while start + _HEAD.size <= len(content):
        opcode, length = _HEAD.unpack_from(content, start)
        start += _HEAD.size
        body = content[start : start + length]
        if len(body) == length:
            yield from _record(opcode, body)
        start += length


def _record(opcode: int, body: bytes) -> Iterator[McapRecord]:
    if opcode == Opcode.MESSAGE:
        yield Message.read(_stream(body), len(body))
    elif opcode in _KINDS:
        yield _KINDS[opcode].read(_stream(body))


def _stream(body: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(body))
