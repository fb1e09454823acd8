"""The recordings below a folder as the rule of retention sees them."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from bus.errors import RecordingError
from config.recording import RecordingSettings
from logs.mcap.index import FINE, read_metadata
from logs.mcap.names import found_below, is_folder, reading
from logs.mcap.recorder import PART
from logs.mcap.retention import Plan, Recorded, plan_retention
from logs.mcap.thin import THINNED

_OURS = re.compile(r"(\d{8}T\d{9})(\.recovered)?\.mcap")
"""Only files with the cell's own naming ever go."""
PIN = ".keep"
"""``CYCLE.keep`` beside ``CYCLE.mcap`` protects that recording."""


def cycle_of(path: Path) -> str:
    """Return the cycle of a recording of the cell's own naming; "" for any other name."""
    named = _OURS.fullmatch(path.name.removesuffix(PART))
    return named[1] if named else ""


def free_on_disk(folder: Path) -> int:
    """Free space of a folder's disk [bytes]. Raises: RecordingError."""
    with reading(folder):
        return shutil.disk_usage(folder).free


class Shelf:
    """The recordings below a folder; metadata that was read is cached.

    Args:
        read: reads the metadata of a recording.
        rest: called between two reads, to leave processor time to the cell.
        labelled: the cycles that persons have labelled. ``free``: free space of a folder's disk [bytes].
    """

    def __init__(
        self,
        folder: Path,
        read: Callable[[Path], dict[str, str]] = read_metadata,
        rest: Callable[[], None] = lambda: None,
        labelled: Callable[[], frozenset[str]] = frozenset,
        free: Callable[[Path], int] = free_on_disk,
    ) -> None:
        self._folder, self._read, self._rest, self._labelled, self._free = folder, read, rest, labelled, free
        self._known: dict[tuple[Path, int], tuple[str, bool]] = {}

    def plan(self, now_ns: int, settings: RecordingSettings) -> Plan:
        """Return what goes now and within a day; only candidates are read. ``now_ns``: UTC. Raises: RecordingError."""
        if not settings.rules or not is_folder(self._folder):
            return Plan()
        free = self._free(self._folder) if settings.keep_free_gb else None
        files = list(self._files(self._labelled() if settings.keep_labelled else frozenset()))
        suspects = {
            one.file.path
            for result in ("", FINE[0])  # whichever it is
            for group in plan_retention([file._replace(result=result) for file in files], now_ns, settings, free)[:3]
            for one in group
        }
        if suspects and (settings.keep_gb or settings.keep_free_gb):  # a failure is kept, so a newer success must go
            suspects = {file.path for file in files}
        return plan_retention([self._looked_at(file, suspects) for file in files], now_ns, settings, free)

    def _files(self, labelled: frozenset[str]) -> Iterator[Recorded]:
        for path in (*found_below(self._folder, "*.mcap"), *found_below(self._folder, f"*.mcap{PART}")):
            cycle_id = cycle_of(path)
            with suppress(FileNotFoundError, ValueError):  # deleted meanwhile; a name without a valid time
                stamp_ns = _stamp_ns(cycle_id) if cycle_id else 0
                is_pinned = path.suffix == PART or not cycle_id or cycle_id in labelled or is_protected(path)
                yield Recorded(path, _bytes(path) + _bytes(path.with_suffix(".html")), stamp_ns, "", is_pinned)

    def _looked_at(self, file: Recorded, suspects: set[Path]) -> Recorded:
        if file.is_pinned or file.path not in suspects:
            return file
        key = (file.path, file.bytes)
        if key not in self._known:
            try:
                said = self._read(file.path)
                self._known[key] = said.get("result", ""), THINNED in said
            except RecordingError:
                self._known[key] = "", False
            self._rest()
        result, is_thin = self._known[key]
        return file._replace(result=result, is_thin=is_thin)


def is_protected(path: Path) -> bool:
    """Whether a person has pinned a recording, or it lies elsewhere."""
    return path.is_symlink() or path.with_suffix(PIN).exists()


def _bytes(path: Path) -> int:
    try:
        return os.lstat(path).st_size
    except FileNotFoundError:
        return 0


def _stamp_ns(cycle_id: str) -> int:
    began = datetime.strptime(f"{cycle_id}000", "%Y%m%dT%H%M%S%f").replace(tzinfo=UTC)
    return round(began.timestamp() * 1e3) * 10**6
