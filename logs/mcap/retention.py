"""Selects the recordings to delete when space is limited: the oldest successes first, failures last."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from bus.errors import RecordingError
from config.schema import RecordingSettings
from logs.mcap.index import FINE, read_metadata
from logs.mcap.names import found_below, is_folder
from logs.mcap.recorder import PART

DAY_NS = 24 * 3600 * 10**9
GB = 1e9
_OURS = re.compile(r"(\d{8}T\d{9})(\.recovered)?\.mcap")
"""Only files with the cell's own naming are ever deleted."""
_DAY = re.compile(r"\d{4}-\d{2}-\d{2}")
_INDEX = "index.html"
PIN = ".keep"
"""``CYCLE.keep`` beside ``CYCLE.mcap`` protects that recording from deletion."""


class Recorded(NamedTuple):
    """One recording as the retention rule sees it.

    Attributes:
        bytes: size, its page included. ``stamp_ns``: start of its cycle, UTC.
        result: of its metadata; "" when not read or unreadable, which is treated as a failure.
        is_pinned: it counts, but is never deleted: still being written, not recovered, or pinned by a person.
    """

    path: Path
    bytes: int
    stamp_ns: int
    result: str = ""
    is_pinned: bool = False

    @property
    def is_fine(self) -> bool:
        """True when the recording needs no attention."""
        return self.result in FINE


class Plan(NamedTuple):
    """The recordings to delete, the oldest first.

    Attributes:
        delete: now. ``soon``: within a day, if the cell records as much as during the last day.
    """

    delete: tuple[Recorded, ...]
    soon: tuple[Recorded, ...]


def plan_retention(files: Sequence[Recorded], now_ns: int, settings: RecordingSettings) -> Plan:
    """Apply the rule of `RecordingSettings`; never delete the newest recording or a pinned one. ``now_ns``: UTC."""
    delete = _due(files, now_ns, settings, 0)
    left = [file for file in files if file not in set(delete)]
    grown = sum(file.bytes for file in files if now_ns - DAY_NS < file.stamp_ns <= now_ns)
    return Plan(tuple(delete), tuple(_due(left, now_ns + DAY_NS, settings, grown)))


def _due(files: Sequence[Recorded], at_ns: int, settings: RecordingSettings, more_bytes: int) -> list[Recorded]:
    newest_ns = max((file.stamp_ns for file in files if not file.is_pinned), default=0)
    candidates = sorted(
        (file for file in files if not file.is_pinned and file.stamp_ns < newest_ns),
        key=lambda file: (not file.is_fine, file.stamp_ns, file.path),
    )
    kept_bytes = sum(file.bytes for file in files) + more_bytes
    due = []
    for file in candidates:
        is_old = settings.keep_days > 0 and file.is_fine and at_ns - file.stamp_ns > settings.keep_days * DAY_NS
        is_too_much = settings.keep_gb > 0 and kept_bytes > settings.keep_gb * GB
        if is_old or is_too_much:
            due.append(file)
            kept_bytes -= file.bytes
    return due


# --- files ------------------------------------------------------------------------------------------------------------


class Shelf:
    """The recordings below a folder; results that were read are cached.

    Args:
        read: reads the metadata of a recording.
        rest: called between two reads, to leave processor time to the cell.
    """

    def __init__(
        self,
        folder: Path,
        read: Callable[[Path], dict[str, str]] = read_metadata,
        rest: Callable[[], None] = lambda: None,
    ) -> None:
        self._folder, self._read, self._rest = folder, read, rest
        self._results: dict[tuple[Path, int], str] = {}

    def plan(self, now_ns: int, settings: RecordingSettings) -> Plan:
        """The recordings to delete now and within a day; only candidates are read. ``now_ns``: UTC.

        Raises: RecordingError.
        """
        if not (settings.keep_gb or settings.keep_days) or not is_folder(self._folder):
            return Plan((), ())
        files = list(self._files())
        as_fine = [file._replace(result=FINE[0]) for file in files]
        suspects = {file.path for group in plan_retention(as_fine, now_ns, settings) for file in group}
        if settings.keep_gb and suspects:  # a failure among them is kept, so a newer success must go
            suspects = {file.path for file in files}
        return plan_retention([self._looked_at(file, suspects) for file in files], now_ns, settings)

    def _files(self) -> Iterator[Recorded]:
        for path in (*found_below(self._folder, "*.mcap"), *found_below(self._folder, f"*.mcap{PART}")):
            named = _OURS.fullmatch(path.name.removesuffix(PART))
            with suppress(FileNotFoundError, ValueError):  # deleted meanwhile; a name without a valid time
                stamp_ns = _stamp_ns(named[1]) if named else 0
                is_pinned = path.suffix == PART or not named or path.is_symlink() or path.with_suffix(PIN).exists()
                yield Recorded(path, _bytes(path) + _bytes(path.with_suffix(".html")), stamp_ns, "", is_pinned)

    def _looked_at(self, file: Recorded, suspects: set[Path]) -> Recorded:
        if file.is_pinned or file.path not in suspects:
            return file
        key = (file.path, file.stamp_ns)
        if key not in self._results:
            try:
                self._results[key] = self._read(file.path).get("result", "")
            except RecordingError:
                self._results[key] = ""
            self._rest()
        return file._replace(result=self._results[key])


def delete(files: Iterable[Recorded]) -> Iterator[Recorded | RecordingError]:
    """Delete recordings with their pages, and day folders that become empty; yield each, or the error that kept it."""
    for file in files:
        try:
            file.path.with_suffix(".html").unlink(missing_ok=True)
            file.path.unlink(missing_ok=True)
            _tidy(file.path.parent)
        except OSError as error:
            yield RecordingError(f"{file.path} cannot be deleted: {error.strerror}.", "Check who may write its folder.")
        else:
            yield file


def _tidy(day: Path) -> None:
    if _DAY.fullmatch(day.name) and {one.name for one in day.iterdir()} <= {_INDEX}:
        (day / _INDEX).unlink(missing_ok=True)
        day.rmdir()


def _bytes(path: Path) -> int:
    try:
        return os.lstat(path).st_size
    except FileNotFoundError:
        return 0


def _stamp_ns(cycle_id: str) -> int:
    began = datetime.strptime(f"{cycle_id}000", "%Y%m%dT%H%M%S%f").replace(tzinfo=UTC)
    return round(began.timestamp() * 1e3) * 10**6


def in_words(files: Sequence[Recorded]) -> str:
    """A summary: ``12 recordings (0.34 GB, 2 of them failures)``."""
    failures = sum(not file.is_fine for file in files)
    among = f", {failures} of them failures" if failures else ""
    return f"{len(files)} recordings ({sum(file.bytes for file in files) / GB:.2f} GB{among})"
