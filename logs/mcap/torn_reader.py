"""Reads a torn or damaged MCAP file as far as possible, and counts the losses.

A killed process leaves its chunks up to the last flush, and possibly a truncated one that was never flushed and is left
out. A power cut may leave trailing zeros. A chunk whose checksum is wrong is left out and counted as lost, and reading
continues behind it: of a recorded cycle with one flipped bit 98 % of the messages are kept, where a reader that stops
at the first damage keeps 51 % (with an erased sector 95 and 42 %; ``benchmarks torn``). After a mere kill both keep the
same.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import IO

from mcap.opcode import Opcode
from mcap.records import McapRecord
from mcap.writer import MCAP0_MAGIC

from logs.mcap.finished_reader import Summary
from logs.mcap.records import (
    HEAD,
    IN_CHUNK,
    INDICES,
    MAX_RECORD_BYTES,
    Budget,
    Damage,
    UnknownCompression,
    content_of,
    framed,
    parsed,
)

_KEPT = (*IN_CHUNK, Opcode.ATTACHMENT, Opcode.METADATA)
_KNOWN = (*_KEPT, *INDICES, Opcode.CHUNK)
_BLOCK_BYTES = 1 << 20


@dataclass
class Losses:
    """The parts of a file that were not kept.

    Attributes:
        damaged: chunks and records with damage inside.
        unknown_chunks: chunks in an unknown compression.
        unknown_records: records of an unknown kind, or bytes that form no record.
        orphans: messages whose channel was lost.
    """

    damaged: int = 0
    unknown_chunks: int = 0
    unknown_records: int = 0
    orphans: int = 0

    def __bool__(self) -> bool:
        return any(vars(self).values())

    def __str__(self) -> str:
        said = (
            (self.damaged, "damaged parts"),
            (self.unknown_chunks, "chunks in an unknown compression"),
            (self.unknown_records, "pieces that are no record of this cell"),
            (self.orphans, "messages without their channel"),
        )
        return ", ".join(f"{count} {what}" for count, what in said if count)


class TornReader:
    """The torn reader: reads ``source`` in order, and continues after damaged chunks.

    Attributes:
        is_finished: the file ends as a finished one. ``losses``: the parts left out.
    """

    def __init__(self, source: IO[bytes]) -> None:
        self._source = source
        self._size = os.fstat(source.fileno()).st_size
        self._budget = Budget(self._size)
        self.is_finished = False
        self.losses = Losses()

    def records(self) -> Iterator[McapRecord]:
        """Yield the readable records, up to the end of the data section or the truncated end. Raises: OSError."""
        yield from self._repeated()
        self._source.seek(0)
        if self._source.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            return
        while len(head := self._source.read(HEAD.size)) == HEAD.size:
            opcode, length = HEAD.unpack(head)
            left = self._size - self._source.tell()
            self.is_finished = opcode == Opcode.DATA_END and length <= left
            if self.is_finished or opcode == 0 or length > left:
                self._end(opcode, length)
                return
            yield from self._one(opcode, length)

    def _repeated(self) -> Iterator[McapRecord]:
        """The schemas and channels that a finished file repeats in its summary, in place of those in damaged chunks."""
        try:
            summary = Summary(self._source)
        except Damage:
            return
        yield from (*summary.schemas.values(), *summary.channels.values())

    def _one(self, opcode: int, length: int) -> Iterator[McapRecord]:
        if length > MAX_RECORD_BYTES:
            self.losses.damaged += 1
            self._source.seek(length, os.SEEK_CUR)
            return
        body = self._source.read(length)
        if opcode == Opcode.CHUNK:
            yield from self._chunk(body)
        elif opcode in _KEPT:
            yield from self._whole(opcode, body)
        elif opcode not in INDICES:
            self.losses.unknown_records += 1

    def _end(self, opcode: int, length: int) -> None:
        """Classify the end of the data: a partly written record, or zeros, are not counted as a loss."""
        if opcode == 0:
            self._source.seek(-HEAD.size, os.SEEK_CUR)
            self.losses.unknown_records += not self._only_zeros_follow()
        elif opcode not in _KNOWN:
            self.losses.unknown_records += 1
        elif length > MAX_RECORD_BYTES:  # too long for a record that was being written
            self.losses.damaged += 1

    def _only_zeros_follow(self) -> bool:
        for _ in range(MAX_RECORD_BYTES // _BLOCK_BYTES):
            block = self._source.read(_BLOCK_BYTES)
            if block.count(0) < len(block) or not block:
                return not block
        return False

    def _chunk(self, body: bytes) -> Iterator[McapRecord]:
        try:
            content = content_of(body, self._budget)
        except UnknownCompression:
            self.losses.unknown_chunks += 1
            return
        except Damage:
            self.losses.damaged += 1
            return
        try:
            for opcode, part in framed(content):
                yield from self._within(opcode, part)
        except Damage:
            self.losses.unknown_records += 1

    def _within(self, opcode: int, body: bytes) -> Iterator[McapRecord]:
        if opcode in IN_CHUNK:
            yield from self._whole(opcode, body)
        else:
            self.losses.unknown_records += 1

    def _whole(self, opcode: int, body: bytes) -> Iterator[McapRecord]:
        try:
            self._budget.spend(len(body))
            record = parsed(opcode, body)
        except Damage:
            self.losses.damaged += 1
            return
        yield record
