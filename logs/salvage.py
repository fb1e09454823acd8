"""Reads a torn or damaged MCAP file as far as it can be read.

A process that was killed leaves its chunks up to the last flush, and perhaps the beginning of one more, which was never
flushed; of that, the messages that are complete are kept too. A chunk whose checksum is wrong is left out, and counted
as lost.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from io import BytesIO
from typing import IO, Any

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from logs.reader import DAMAGE

_HEAD = struct.Struct("<BQ")
_CHUNK_FIXED = 8 + 8 + 8 + 4  # start, end, uncompressed size, checksum; then the compression's name
_LENGTH = struct.Struct("<I")
_KINDS: dict[int, Any] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
}


class Salvage:
    """Reads what can be read of ``source``, in order, and goes on behind a chunk that is damaged.

    Attributes:
        is_finished: the file ended as a finished one does.
        lost_chunks: damaged parts that were left out.
    """

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
