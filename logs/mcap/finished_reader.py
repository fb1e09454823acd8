"""Reads finished MCAP files: sequentially, or single records through the summary at the end."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from typing import IO

from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    McapRecord,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
)
from mcap.writer import MCAP0_MAGIC

from logs.mcap.records import (
    HEAD,
    IN_CHUNK,
    INDICES,
    KINDS,
    MAX_RECORD_BYTES,
    Budget,
    Damage,
    content_of,
    framed,
    parsed,
)

_FOOTER = struct.Struct("<BQQQI")
_U32 = struct.Struct("<I")
_IN_SUMMARY = frozenset(
    {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX}
)


def records(file: IO[bytes]) -> Iterator[McapRecord]:
    """Yield schemas, channels, messages, attachments and metadata of a finished file in order, checksums verified.

    Raises: Damage for a file that is not an MCAP, torn, damaged or beyond the limits; OSError.
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
    elif opcode not in INDICES and opcode in (*KINDS, Opcode.MESSAGE):
        yield parsed(opcode, body)


class Summary:
    """The summary of a finished file: positions of its records, so that single ones can be read.

    Attributes:
        is_there: the file has a summary. ``schemas``, ``channels``: by id. ``chunks``: their indices.

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
        """All metadata tables, in order."""
        for index in self._metadata:
            record = self._at(index.offset, Opcode.METADATA)
            if isinstance(record, Metadata):
                yield record

    def attachment(self, name: str) -> bytes | None:
        """Return the newest attachment of this name; None without one."""
        found = [index for index in self._attachments if index.name == name]
        record = self._at(found[-1].offset, Opcode.ATTACHMENT) if found else None
        return record.data if isinstance(record, Attachment) else None

    def messages(self, topics: frozenset[str]) -> Iterator[tuple[str, bytes]]:
        """Topic and payload of every message of ``topics``, in the order of the file."""
        return ((topic, payload) for topic, _, payload in self.timed_messages(topics))

    def timed_messages(self, topics: frozenset[str]) -> Iterator[tuple[str, int, bytes]]:
        """Topic, log time [ns UTC] and payload of every message of ``topics``, in the order of the file."""
        wanted = {one.id: one.topic for one in self.channels.values() if one.topic in topics}
        for index in self.chunks:
            if not wanted.keys().isdisjoint(index.message_index_offsets):
                chunk = self._read(index.chunk_start_offset, Opcode.CHUNK)
                for kind, part in framed(content_of(chunk, self._budget)):
                    self._budget.spend(0)
                    message = parsed(kind, part) if kind == Opcode.MESSAGE else None
                    if isinstance(message, Message) and message.channel_id in wanted:
                        yield wanted[message.channel_id], message.log_time, message.data

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
    """Offset of the summary (0 = none), and its checksum. Raises: Damage."""
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
