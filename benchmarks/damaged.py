"""The share of a damaged recording that is kept: by our reader, and by one that stops at the first damage."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Iterator, Sequence
from io import BytesIO
from pathlib import Path
from statistics import mean
from tempfile import TemporaryDirectory
from typing import Any

import zstandard
from mcap.exceptions import McapError
from mcap.records import McapRecord, Message
from mcap.stream_reader import StreamReader

from logs.mcap.torn_reader import TornReader

_SECTOR_BYTES = 4096
_ENDS = (McapError, EOFError, zstandard.ZstdError, struct.error, ValueError, KeyError)
"""Whatever the library's reader and its decompressors raise for bytes that are wrong."""


def run(recording: Path, tries: int, seed: int) -> dict[str, Any]:
    """For each kind of damage, at ``tries`` random places: messages kept [%], on average and in the worst tenth."""
    content, rng = recording.read_bytes(), random.Random(seed)
    return {name: _kept(content, damage, tries, rng) for name, damage in _DAMAGES.items()}


def _kept(content: bytes, damage: Callable[[bytearray, int], None], tries: int, rng: random.Random) -> dict[str, Any]:
    whole = messages(up_to_damage(content))
    shares: dict[str, list[float]] = {"salvaged": [], "up_to_the_damage": []}
    for _ in range(tries):
        spoiled = bytearray(content)
        damage(spoiled, rng.randrange(len(content)))
        shares["salvaged"].append(100 * messages(_salvaged(bytes(spoiled))) / whole)
        shares["up_to_the_damage"].append(100 * messages(up_to_damage(bytes(spoiled))) / whole)
    return {name: _spread(percents) for name, percents in shares.items()}


def _spread(percents: Sequence[float]) -> dict[str, float]:
    worst = sorted(percents)[: max(1, len(percents) // 10)]
    return {"mean": round(mean(percents), 1), "worst_tenth": round(mean(worst), 1)}


def up_to_damage(content: bytes) -> Iterator[McapRecord]:
    """Every record that the library's reader gives before it gives up."""
    try:
        yield from StreamReader(BytesIO(content), validate_crcs=True).records
    except _ENDS:
        return


def _salvaged(content: bytes) -> Iterator[McapRecord]:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "one.mcap"
        path.write_bytes(content)
        with path.open("rb") as file:
            yield from TornReader(file).records()


def messages(records: Iterator[McapRecord]) -> int:
    """Return how many of them are messages."""
    return sum(isinstance(record, Message) for record in records)


def _flip(content: bytearray, at: int) -> None:
    content[at] ^= 0x10


def _erase(content: bytearray, at: int) -> None:
    start = at - at % _SECTOR_BYTES
    content[start : start + _SECTOR_BYTES] = bytes(len(content[start : start + _SECTOR_BYTES]))


_DAMAGES = {"flipped_bit": _flip, "erased_sector": _erase}
