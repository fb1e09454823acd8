"""Makes room: trims and deletes recordings by the rule of their settings, archived before, written down before.

A recording that is open (``.part``), unfinished, pinned, labelled, linked, or of another name than the cell's is never
touched, and neither is the newest one.
"""

from __future__ import annotations

import fcntl
import os
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from bus.errors import RecordingError
from config.recording import RecordingSettings
from logs.archive import Archive, Archived
from logs.catalogue.deleted_row import row_for_journal
from logs.catalogue.journal import Gone, append
from logs.catalogue.labels import read_labels
from logs.catalogue.rows import file_of, row_of
from logs.mcap.index import read_metadata
from logs.mcap.names import is_folder, reading, shown
from logs.mcap.recorder import MODE, PART
from logs.mcap.retention import Due, Plan
from logs.mcap.shelf import Shelf, cycle_of, free_on_disk, is_protected
from logs.mcap.thin import ARCHIVED, ARCHIVED_SHA256, thin

_LOCK = ".prune.lock"
_DAY = re.compile(r"\d{4}-\d{2}-\d{2}")
_OF_PAGES = re.compile(r"index\.html|.*\.what-if\.html|plotly-[\w.-]+\.js")
"""Files beside the pages of a day."""
_STILL_WRITTEN_S = 10.0
"""A cycle writes more often than this: its nodes say once a second how they are."""


class Done(NamedTuple):
    """One recording that went, and the space it gave back; its copy, where there is one."""

    due: Due
    freed_bytes: int
    archived: str


class Pruner:
    """Prunes one folder of recordings. Its methods raise RecordingError.

    Args:
        settings: folder, rule and archive. ``rest``: called between two recordings that are read.
        clock_ns: UTC. ``free``: free space of a folder's disk [bytes].

    Raises: ConfigError for an archive that cannot be used.
    """

    def __init__(
        self,
        settings: RecordingSettings,
        rest: Callable[[], None] = lambda: None,
        clock_ns: Callable[[], int] = time.time_ns,
        free: Callable[[Path], int] = free_on_disk,
    ) -> None:
        self._settings, self._root, self._clock_ns = settings, settings.folder, clock_ns
        self._archive = Archive(settings.archive, self._root) if settings.archive and settings.rules else None
        self._shelf = Shelf(self._root, read_metadata, rest, self._labelled, free)

    def plan(self) -> Plan:
        """Return what goes now, and within a day."""
        return self._shelf.plan(self._clock_ns(), self._settings)

    @contextmanager
    def alone(self) -> Iterator[bool]:
        """Context in which no other process prunes the folder; False when one does."""
        if not is_folder(self._root):
            yield True
            return
        try:
            file = os.open(self._root / _LOCK, os.O_RDWR | os.O_CREAT, MODE)
        except OSError as error:
            raise RecordingError(
                f"{self._root} cannot be pruned: {error.strerror}.", "Check who may write there."
            ) from error
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
        else:
            yield True
        finally:
            os.close(file)

    def do(self, due: Due) -> Done | None:
        """Trim or delete one recording; None for one that is gone, or that a person has protected since.

        It is archived first, then written down, then it goes: whatever ends the process, nothing is lost unsaid.
        """
        path = due.file.path
        is_labelled = self._settings.keep_labelled and cycle_of(path) in self._labelled()
        with reading(path):
            if is_labelled or is_protected(path) or not path.is_file():
                return None
        copy = self._archived(path)
        now_ns = self._clock_ns()
        gone = Gone(
            file=os.path.relpath(path, self._root), cycle_id=cycle_of(path), at_ns=now_ns, why=due.why,
            what="trimmed", archived=copy.address, sha256=copy.sha256,
        )  # fmt: skip
        if due.act == "thin":
            append(self._root, gone)
            return Done(due, thin(path, now_ns, *copy), copy.address)
        row = row_for_journal(row_of(self._root, file_of(path, self._root)))
        append(self._root, gone.model_copy(update={"what": "deleted", "freed_bytes": due.file.bytes, "row": row}))
        _delete(path)
        return Done(due, due.file.bytes, copy.address)

    def _archived(self, path: Path) -> Archived:
        """The copy of the whole recording: that of a trimmed one was made before. Raises: ArchiveError."""
        try:
            said = read_metadata(path)
        except RecordingError:  # damaged: it is copied as it is
            said = {}
        if ARCHIVED in said:
            return Archived(said[ARCHIVED], said.get(ARCHIVED_SHA256, ""))
        if self._archive is None:
            return Archived("", "")
        return self._archive.put(path, os.path.relpath(path, self._root))

    def _labelled(self) -> frozenset[str]:
        return frozenset(one.cycle_id for one in read_labels(self._root))


def is_recording(root: Path) -> bool:
    """Whether a cycle of the folder is being recorded: its file changes at least once a second.

    Raises: RecordingError.
    """
    if not is_folder(root):
        return False
    with reading(root):
        days = sorted(one for one in root.iterdir() if _DAY.fullmatch(one.name))[-2:]  # a cycle may last over midnight
        return any(_is_fresh(part) for folder in (root, *days) for part in folder.glob(f"*.mcap{PART}"))


def _is_fresh(path: Path) -> bool:
    try:
        return abs(time.time() - path.stat().st_mtime) < _STILL_WRITTEN_S
    except FileNotFoundError:
        return False


def _delete(path: Path) -> None:
    """Delete a recording with its page, and its day's folder when that becomes empty. Raises: RecordingError."""
    try:
        path.with_suffix(".html").unlink(missing_ok=True)
        path.unlink(missing_ok=True)
        day = path.parent
        left = list(day.iterdir())
        if _DAY.fullmatch(day.name) and all(_OF_PAGES.fullmatch(one.name) for one in left):
            for one in left:
                one.unlink()
            day.rmdir()
    except OSError as error:
        raise RecordingError(
            f"{shown(path)} cannot be deleted: {error.strerror}.", "Check who may write its folder."
        ) from error
