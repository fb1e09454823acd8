"""Reads MCAP records from bytes that anybody may have written: in bounded work, and with one error for all of it.

The library's own readers make room for whatever a file says of itself, and end in whatever Python raises then.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from io import BytesIO
from typing import IO, Any, cast

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    McapRecord,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
)
from mcap.writer import MCAP0_MAGIC

MAX_CHUNK_BYTES = 128 * 1024 * 1024
"""Of a chunk's content. The recorder's hold 1 MiB and the message that made them full, at most 64 MiB."""
MAX_RECORD_BYTES = 256 * 1024 * 1024
"""Of one record as it lies in the file."""
HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_FOOTER = struct.Struct("<BQQQI")
_TIMES_SIZE_AND_CHECKSUM = 8 + 8 + 8 + 4
_BLOCK_BYTES = 1 << 17
_U32 = struct.Struct("<I")
_KINDS: dict[int, Any] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
    Opcode.CHUNK: Chunk,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.METADATA_INDEX: MetadataIndex,
}
_IN_SUMMARY = frozenset(
    {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX}
)
IN_CHUNK = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE})
INDICES = frozenset(
    {
        Opcode.HEADER,
        Opcode.FOOTER,
        Opcode.MESSAGE_INDEX,
        Opcode.CHUNK_INDEX,
        Opcode.ATTACHMENT_INDEX,
        Opcode.METADATA_INDEX,
        Opcode.STATISTICS,
        Opcode.SUMMARY_OFFSET,
        Opcode.DATA_END,
    }
)
"""What only repeats, or frames, the rest."""


class Damage(Exception):
    """What is wrong with a file's bytes: half a sentence for a person."""


class UnknownCompression(Damage):
    """A chunk in a compression that this program does not know: nothing need be wrong with it."""


class Budget:
    """How much a file may hold in all [bytes], by its own size: 200 times as much, which no recording comes near.

    Raises: Damage when it holds more.
    """

    _LEAST, _MOST, _TIMES, _A_RECORD = 256 << 20, 2 << 30, 200, 256

    def __init__(self, file_bytes: int) -> None:
        self._left = min(self._MOST, self._LEAST + self._TIMES * file_bytes)

    def spend(self, content_bytes: int) -> None:
        """For one record; the least one costs something, too."""
        self._left -= content_bytes + self._A_RECORD
        if self._left < 0:
            raise Damage("it holds more than a recording can")


# --- whole files ------------------------------------------------------------------------------------------------------


def records(file: IO[bytes]) -> Iterator[McapRecord]:
    """The schemas, channels, messages, attachments and metadata of a finished file, in order, checksums looked at.

    Raises: Damage for a file that is no MCAP, torn, damaged or beyond all bounds; OSError.
    """
    size = os.fstat(file.fileno()).st_size
    budget = Budget(size)
    _require_end(file, size)
    file.seek(0)
    crc = zlib.crc32(_require_magic(file))
    while True:
        head = file.read(HEAD.size)
        if len(head) < HEAD.size:
            raise Damage("it ends early")
        opcode, body = _body(file, *HEAD.unpack(head))
        budget.spend(len(body))
        if opcode == Opcode.DATA_END:
            if body[:4] not in (_U32.pack(crc), bytes(4)):
                raise Damage("its checksum is wrong")
            return
        crc = zlib.crc32(body, zlib.crc32(head, crc))
        yield from _data(opcode, body, budget)


def _data(opcode: int, body: bytes, budget: Budget) -> Iterator[McapRecord]:
    if opcode == Opcode.CHUNK:
        for kind, part in framed(content_of(body, budget)):
            budget.spend(0)
            if kind in IN_CHUNK:
                yield parsed(kind, part)
    elif opcode not in INDICES and opcode in (*_KINDS, Opcode.MESSAGE):
        yield parsed(opcode, body)


class Summary:
    """The summary of a finished file: where things are, so that a few are read and not the whole.

    Attributes:
        is_there: the file has one. ``schemas``, ``channels``: by id. ``chunks``: where they are.

    Raises: Damage, OSError; also from its methods.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        size = os.fstat(file.fileno()).st_size
        self._budget = Budget(size)
        start, crc = _require_end(file, size)
        end = size - len(MCAP0_MAGIC) - _FOOTER.size
        self.is_there = start != 0
        said = [*_summary(file, start, end, crc, self._budget)] if self.is_there else []
        self.schemas = {record.id: record for record in said if isinstance(record, Schema)}
        self.channels = {record.id: record for record in said if isinstance(record, Channel)}
        self.chunks = [record for record in said if isinstance(record, ChunkIndex)]
        self._attachments = [record for record in said if isinstance(record, AttachmentIndex)]
        self._metadata = [record for record in said if isinstance(record, MetadataIndex)]

    def metadata(self) -> Iterator[Metadata]:
        """Every table of strings, in order."""
        for index in self._metadata:
            record = self._at(index.offset, Opcode.METADATA)
            if isinstance(record, Metadata):
                yield record

    def attachment(self, name: str) -> bytes | None:
        """The newest file of this name; None without one."""
        found = [index for index in self._attachments if index.name == name]
        record = self._at(found[-1].offset, Opcode.ATTACHMENT) if found else None
        return record.data if isinstance(record, Attachment) else None

    def messages(self, topics: frozenset[str]) -> Iterator[tuple[str, bytes]]:
        """Topic and payload of every message of ``topics``, in the order of the file."""
        wanted = {one.id: one.topic for one in self.channels.values() if one.topic in topics}
        for index in self.chunks:
            if not wanted.keys().isdisjoint(index.message_index_offsets):
                chunk = self._read(index.chunk_start_offset, Opcode.CHUNK)
                for kind, part in framed(content_of(chunk, self._budget)):
                    self._budget.spend(0)
                    message = parsed(kind, part) if kind == Opcode.MESSAGE else None
                    if isinstance(message, Message) and message.channel_id in wanted:
                        yield wanted[message.channel_id], message.data

    def _at(self, offset: int, expected: int) -> McapRecord:
        return parsed(expected, self._read(offset, expected))

    def _read(self, offset: int, expected: int) -> bytes:
        self._file.seek(min(offset, 1 << 62))
        head = self._file.read(HEAD.size)
        if len(head) < HEAD.size or head[0] != expected:
            raise Damage("its index is wrong")
        _, body = _body(self._file, *HEAD.unpack(head))
        self._budget.spend(len(body))
        return body


def _summary(file: IO[bytes], start: int, end: int, crc: int, budget: Budget) -> Iterator[McapRecord]:
    if not 0 < start <= end or end - start > MAX_RECORD_BYTES:
        raise Damage("its summary is not where it should be")
    file.seek(start)
    content = file.read(end - start)
    file.seek(end)
    if crc not in (0, zlib.crc32(content + file.read(_FOOTER.size - _U32.size))):
        raise Damage("its summary's checksum is wrong")
    for kind, part in framed(content):
        budget.spend(len(part))
        if kind in _IN_SUMMARY:
            yield parsed(kind, part)


def _require_magic(file: IO[bytes]) -> bytes:
    magic = file.read(len(MCAP0_MAGIC))
    if magic != MCAP0_MAGIC:
        raise Damage("it does not begin as one")
    return magic


def _require_end(file: IO[bytes], size: int) -> tuple[int, int]:
    """Where the summary starts (0 = there is none), and its checksum."""
    _require_magic(file)
    if size < 2 * len(MCAP0_MAGIC) + _FOOTER.size:
        raise Damage("it ends early")
    file.seek(size - len(MCAP0_MAGIC) - _FOOTER.size)
    opcode, length, start, _, crc = _FOOTER.unpack(file.read(_FOOTER.size))
    if (opcode, length) != (Opcode.FOOTER, _FOOTER.size - HEAD.size) or file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise Damage("it does not end as a finished one")
    return start, crc


def _body(file: IO[bytes], opcode: int, length: int) -> tuple[int, bytes]:
    if opcode == 0:
        raise Damage("it holds a record of no kind")
    if length > MAX_RECORD_BYTES:
        raise Damage(f"a record of it says that it has {length} bytes")
    body = file.read(length)
    if len(body) < length:
        raise Damage("it ends early")
    return opcode, body


# --- parts of files ---------------------------------------------------------------------------------------------------


def framed(content: bytes) -> Iterator[tuple[int, bytes]]:
    """(opcode, body) of each record that lies whole in ``content``. Raises: Damage for what is left then, and is none.

    An opcode of 0, which no record has, ends it.
    """
    start = 0
    while start < len(content):
        if len(content) - start < HEAD.size or content[start] == 0:
            raise Damage("bytes that make no record")
        opcode, length = HEAD.unpack_from(content, start)
        start += HEAD.size
        if length > len(content) - start:
            raise Damage("a record that is cut off")
        yield opcode, content[start : start + length]
        start += length


def parsed(opcode: int, body: bytes) -> McapRecord:
    """The record of one of the kinds that hold something. Raises: Damage when ``body`` is none of these."""
    try:
        if opcode == Opcode.MESSAGE:
            channel_id, sequence, log_time, publish_time = _MESSAGE.unpack_from(body)
            return Message(channel_id, log_time, body[_MESSAGE.size :], publish_time, sequence)
        stream = _Exact(BytesIO(body))
        record: McapRecord = _KINDS[opcode].read(stream)
    except (McapError, struct.error, ValueError, KeyError, OverflowError) as error:  # all that its parsers raise
        raise Damage(f"a record that does not fit its kind, {opcode}") from error
    if opcode == Opcode.ATTACHMENT:
        _require_checksum(body[: stream.count])
    return record


class _Exact(ReadDataStream):
    """Never less than was asked for."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) < length:
            raise EndOfFile
        return data


def _require_checksum(attachment: bytes) -> None:
    said = attachment[-_U32.size :]
    if said not in (bytes(4), _U32.pack(zlib.crc32(attachment[: -_U32.size]))):
        raise Damage("an attachment's checksum is wrong")


def content_of(body: bytes, budget: Budget) -> bytes:
    """What the chunk holds, its checksum looked at. Raises: Damage."""
    chunk = cast(Chunk, parsed(Opcode.CHUNK, body))
    size = chunk.uncompressed_size
    if size > MAX_CHUNK_BYTES:
        raise Damage(f"a chunk says that it holds {size} bytes")
    budget.spend(size)
    content = unpacked(chunk.compression, chunk.data, size)
    if len(content) != size:
        raise Damage("a chunk does not hold as much as it says")
    if chunk.uncompressed_crc not in (0, zlib.crc32(content)):
        raise Damage("a chunk's checksum is wrong")
    return content


def torn_content_of(body: bytes, limit: int) -> bytes:
    """As much as can be unpacked of a chunk that is cut off; nothing has a checksum here but zstd's own blocks.

    Raises: UnknownCompression; Damage when not even its head is whole.
    """
    stream = _Exact(BytesIO(body))
    try:
        stream.read(_TIMES_SIZE_AND_CHECKSUM)
        compression = stream.read_prefixed_string()
        stream.read(8)
    except (McapError, struct.error, ValueError) as error:
        raise Damage("a chunk without its head") from error
    data = body[stream.count :]
    if compression != "zstd":
        return unpacked(compression, data, limit)
    content, reader = bytearray(), zstandard.ZstdDecompressor().stream_reader(data)
    with suppress(zstandard.ZstdError):  # the tear
        while len(content) < limit and (block := reader.read(_BLOCK_BYTES)):
            content += block
    return bytes(content)


def unpacked(compression: str, data: bytes, limit: int) -> bytes:
    """What ``data`` unpacks to, at most a byte more than ``limit``; of cut off data the beginning.

    Raises: Damage, UnknownCompression.
    """
    more = limit + 1  # else what follows the last byte, its checksum, is not looked at
    try:
        if compression == "":
            return data[:more]
        if compression == "zstd":
            return zstandard.ZstdDecompressor().stream_reader(data).read(more)
        if compression == "lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, more))
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise Damage("a chunk does not unpack") from error
    raise UnknownCompression(f"a chunk in the unknown compression {compression[:20]!r}")
