"""Writes an MCAP file: messages are collected in chunks, and flushed chunks can be read without the rest of the file.

The library's own writer offers no level of zstd and makes a compressor for every chunk: on recorded cycles it takes 1.8
times the CPU of this one for the same size, on camera frames 1.3 times; its lz4 takes 0.6 to 1.0 times, and the files
are 37 to 50 % larger (``benchmarks logging``). foxglove-sdk's takes 1.0 to 1.2 times for the same size, but it only
logs a failed write, and the next flush does not report the reason. None of them loses flushed data.
"""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import IO

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

from bus.distribution import OURS

CHUNK_BYTES = 1024 * 1024
_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_HEAD = _MESSAGE.size - 9  # without opcode and length
_CHUNK = struct.Struct("<BQQQQII4sQ")
_CHUNK_HEAD = _CHUNK.size - 9
_LEVEL = 1


class McapFile:
    """Writes MCAP records to ``stream``, which remains the caller's to close. Raises: OSError from every method.

    Attributes:
        crc: CRC-32 of all bytes written.
    """

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self._zstd = zstandard.ZstdCompressor(level=_LEVEL, write_checksum=True)
        self._offset = self.crc = 0
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._indices: dict[type[McapRecord], list[McapRecord]] = defaultdict(list)
        self._counts: dict[int, int] = defaultdict(int)
        self._first_ns = self._last_ns = 0
        self._begin_chunk()
        self._put(MCAP0_MAGIC)
        self._put(_packed(Header(profile="", library=OURS)))

    def schema(self, name: str, encoding: str, data: bytes) -> int:
        """Declare a schema; return its id."""
        record = Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data)
        self._schemas.append(record)
        self._add(_packed(record))
        return record.id

    def channel(self, topic: str, message_encoding: str, schema_id: int) -> int:
        """Declare a channel; return its id. ``schema_id``: 0 = no schema."""
        record = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding=message_encoding,
            schema_id=schema_id,
            metadata={},
        )
        self._channels.append(record)
        self._add(_packed(record))
        return record.id

    def message(self, channel_id: int, log_time_ns: int, payload: bytes, publish_time_ns: int, sequence: int) -> None:
        """Append one message to the open chunk; a full chunk is written. Times are in ns UTC."""
        self._entries[channel_id].append((log_time_ns, self._size))
        self._add(
            _MESSAGE.pack(
                Opcode.MESSAGE,
                _MESSAGE_HEAD + len(payload),
                channel_id,
                sequence & 0xFFFFFFFF,
                log_time_ns,
                publish_time_ns,
            )
        )
        self._add(payload)
        self._times_ns.append(log_time_ns)
        self._counts[channel_id] += 1
        if self._size > CHUNK_BYTES:
            self._end_chunk()

    def attachment(self, time_ns: int, name: str, media_type: str, data: bytes) -> None:
        """Store a whole file as an attachment; ``time_ns``: UTC."""
        self._end_chunk()
        record = Attachment(create_time=time_ns, log_time=time_ns, name=name, media_type=media_type, data=data)
        packed = _packed(record)
        self._index(
            AttachmentIndex(
                offset=self._offset,
                length=len(packed),
                create_time=time_ns,
                log_time=time_ns,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )
        self._put(packed)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Store a named table of strings."""
        self._end_chunk()
        packed = _packed(Metadata(name=name, metadata=dict(values)))
        self._index(MetadataIndex(offset=self._offset, length=len(packed), name=name))
        self._put(packed)

    def flush(self) -> None:
        """Close the chunk and pass all data to the operating system."""
        self._end_chunk()
        self._stream.flush()

    def finish(self) -> None:
        """Write the index and the footer."""
        self._end_chunk()
        self._put(_packed(DataEnd(self.crc)))
        start = self._offset
        groups: list[Sequence[McapRecord]] = [self._schemas, self._channels, [self._statistics()]]
        groups += [self._indices[kind] for kind in (ChunkIndex, AttachmentIndex, MetadataIndex)]
        summary, offsets = b"", b""
        for group in filter(None, groups):
            packed = b"".join(map(_packed, group))
            offsets += _packed(
                SummaryOffset(group_opcode=packed[0], group_start=start + len(summary), group_length=len(packed))
            )
            summary += packed
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, start + len(summary))
        crc = zlib.crc32(summary + offsets + footer)
        self._put(summary + offsets)
        self._put(_packed(Footer(summary_start=start, summary_offset_start=start + len(summary), summary_crc=crc)))
        self._put(MCAP0_MAGIC)

    # --- chunks -------------------------------------------------------------------------------------------------------

    def _begin_chunk(self) -> None:
        self._parts: list[bytes] = []
        self._size = 0
        self._entries: dict[int, list[tuple[int, int]]] = defaultdict(list)
        self._times_ns: list[int] = []

    def _add(self, part: bytes) -> None:
        self._parts.append(part)
        self._size += len(part)

    def _end_chunk(self) -> None:
        """Write the open chunk and its message indices, if it holds a message."""
        if not self._times_ns:
            return
        compressed = self._zstd.compress(b"".join(self._parts))
        first_ns, last_ns = min(self._times_ns), max(self._times_ns)
        start = self._offset
        self._put(
            _CHUNK.pack(
                Opcode.CHUNK,
                _CHUNK_HEAD + len(compressed),
                first_ns,
                last_ns,
                self._size,
                0,  # not computed: zstd's own checksum is verified by every reader, at a tenth of the cost
                4,
                b"zstd",
                len(compressed),
            )
        )
        self._put(compressed)
        chunk_length = self._offset - start
        offsets, packed = {}, b""
        for channel_id, entries in self._entries.items():
            offsets[channel_id] = self._offset + len(packed)
            packed += _packed(MessageIndex(channel_id=channel_id, records=entries))
        self._put(packed)
        self._index(
            ChunkIndex(
                message_start_time=first_ns,
                message_end_time=last_ns,
                chunk_start_offset=start,
                chunk_length=chunk_length,
                message_index_offsets=offsets,
                message_index_length=len(packed),
                compression="zstd",
                compressed_size=len(compressed),
                uncompressed_size=self._size,
            )
        )
        self._first_ns = min(self._first_ns or first_ns, first_ns)
        self._last_ns = max(self._last_ns, last_ns)
        self._begin_chunk()

    def _put(self, data: bytes) -> None:
        self._stream.write(data)
        self._offset += len(data)
        self.crc = zlib.crc32(data, self.crc)

    def _index(self, record: McapRecord) -> None:
        self._indices[type(record)].append(record)

    def _statistics(self) -> Statistics:
        return Statistics(
            message_count=sum(self._counts.values()),
            schema_count=len(self._schemas),
            channel_count=len(self._channels),
            attachment_count=len(self._indices[AttachmentIndex]),
            metadata_count=len(self._indices[MetadataIndex]),
            chunk_count=len(self._indices[ChunkIndex]),
            message_start_time=self._first_ns,
            message_end_time=self._last_ns,
            channel_message_counts=dict(self._counts),
        )


def _packed(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
