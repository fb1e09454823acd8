"""Parses untrusted MCAP records with bounded work, and with Damage as the only error.

The library's readers allocate any size that a file announces, and raise arbitrary exceptions.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from typing import cast

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

MAX_CHUNK_BYTES = 128 * 1024 * 1024
"""Limit of a chunk's uncompressed content. The recorder's chunks hold 1 MiB plus the last message, at most 64 MiB."""
MAX_RECORD_BYTES = 256 * 1024 * 1024
"""Limit of one record in the file."""
HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_U32 = struct.Struct("<I")
KINDS: dict[int, Callable[[ReadDataStream], McapRecord]] = {
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.METADATA: Metadata.read,
    Opcode.CHUNK: Chunk.read,
    Opcode.CHUNK_INDEX: ChunkIndex.read,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex.read,
    Opcode.METADATA_INDEX: MetadataIndex.read,
}
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
"""Kinds of records that only repeat, or frame, the others."""


class Damage(Exception):
    """An error in a file's bytes; the text is half a sentence for a person."""


class UnknownCompression(Damage):
    """A chunk in a compression that this program does not know; it need not be damaged."""


class Budget:
    """The content that a file may hold in total [bytes]: 200 times its own size; recordings stay far below.

    Args:
        file_bytes: size of the file.
    """

    _LEAST, _MOST, _TIMES, _A_RECORD = 256 << 20, 2 << 30, 200, 256

    def __init__(self, file_bytes: int) -> None:
        self._left = min(self._MOST, self._LEAST + self._TIMES * file_bytes)

    def spend(self, content_bytes: int) -> None:
        """Charge one record; even an empty one costs 256 bytes. Raises: Damage when the budget is exceeded."""
        self._left -= content_bytes + self._A_RECORD
        if self._left < 0:
            raise Damage("it holds more than a recording can")


def framed(content: bytes) -> Iterator[tuple[int, bytes]]:
    """(opcode, body) of each whole record in ``content``. An opcode of 0, which no record has, ends it.

    Raises: Damage when the remaining bytes are not a record.
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
    """Return the parsed record of one of the kinds with content. Raises: Damage when ``body`` does not fit the kind."""
    try:
        if opcode == Opcode.MESSAGE:
            channel_id, sequence, log_time, publish_time = _MESSAGE.unpack_from(body)
            return Message(channel_id, log_time, body[_MESSAGE.size :], publish_time, sequence)
        stream = _Exact(BytesIO(body))
        record = KINDS[opcode](stream)
    except (McapError, struct.error, ValueError, KeyError, OverflowError) as error:  # all exceptions of its parsers
        raise Damage(f"a record that does not fit its kind, {opcode}") from error
    if opcode == Opcode.ATTACHMENT:
        _require_checksum(body[: stream.count])
    return record


class _Exact(ReadDataStream):
    """A stream that returns exactly the requested number of bytes, or raises EndOfFile."""

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
    """Return the uncompressed content of a chunk, its checksum verified. Raises: Damage."""
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


def unpacked(compression: str, data: bytes, limit: int) -> bytes:
    """Return the uncompressed ``data``, at most ``limit`` + 1 bytes.

    Raises: Damage, UnknownCompression.
    """
    more = limit + 1  # one more, so that the checksum behind the last byte is checked
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
