"""Brings the catalogue up to date: rows for recordings that are new or have changed; of deleted ones the journal's."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from logs.catalogue.rows import File, row_of
from logs.catalogue.store import CATALOGUE, Stamp, Store
from logs.mcap.names import reading
from logs.mcap.recorder import PART

_DAY = re.compile(r"\d{4}-\d{2}-\d{2}")
_BATCH = 32
_SETTLED_NS = 2 * 10**9
"""A folder that changed within this time may change again without another time."""

Progress = Callable[[Iterable[File], int], Iterable[File]]
"""Passes the recordings on that are to be read, of so many; it may show how far it is."""


def quietly(files: Iterable[File], _total: int) -> Iterable[File]:
    """No progress is shown."""
    return files


def root_of(folder: Path) -> tuple[Path, str]:
    """Return the folder of recordings that a folder belongs to, and the way down to it.

    The catalogue of a day lies in its parent, where there is one; any other folder has its own.
    """
    day = folder.absolute()
    if _DAY.fullmatch(day.name) and (day.parent / CATALOGUE).is_file():
        return day.parent, day.name
    return folder, ""


@dataclass
class Listing:
    """The difference between the folders and the rows.

    Attributes:
        unknown: recordings without a row, or changed since. ``torn``: not finished, or still being written.
        nameless: recordings whose name is not UTF-8: they never get a row.
        gone: names of rows without a file, by folder.
        settled: the times of every folder that was listed; None where it may change without other times, and where
            there are folders in it, which therefore are found each time.
    """

    unknown: list[File]
    torn: list[File]
    nameless: list[File]
    gone: dict[str, list[str]]
    settled: dict[str, Stamp | None]

    @property
    def moving(self) -> set[str]:
        """The folders of recordings that are not finished, or have no name that a row could have."""
        return {file.folder for file in (*self.torn, *self.nameless)}

    def pairs_gone(self) -> set[tuple[str, str]]:
        """Folder and name of every row without a file."""
        return {(folder, name) for folder, names in self.gone.items() for name in names}


def listing(
    store: Store, below: str = "", *, thorough: bool = False, clock_ns: Callable[[], int] = time.time_ns
) -> Listing:
    """Compare the folders with the rows; folders that have not changed are not listed again. Raises: RecordingError.

    Args:
        below: only this folder and those in it.
        thorough: list every folder: a file that was overwritten in place does not change its folder.
        clock_ns: UTC. A clock that was set is no trouble: times are only compared for being the same, and a folder of a
            time to come is listed each time.
    """
    found = Listing([], [], [], {}, {})
    settled = {} if thorough else store.folders()
    visited = set()
    for folder, stamp, is_innermost in _walk(store.root, below, settled):
        visited.add(folder)
        if settled.get(folder) != stamp:
            _compare(store, folder, found)
            if _is_text(folder):
                is_settled = is_innermost and folder not in found.moving and clock_ns() - max(stamp) > _SETTLED_NS
                found.settled[folder] = stamp if is_settled else None
    for folder in store.folders_with_rows():
        if folder not in visited and _is_below(folder, below):
            found.gone[folder] = list(store.known(folder))
    return found


def update(store: Store, listed: Listing, progress: Progress = quietly, rest: Callable[[], None] = lambda: None) -> int:
    """Make the rows what the folders say, batch by batch; return how many were made. Raises: CatalogueError.

    Args:
        rest: called between two recordings, to leave processor time to the cell.
    """
    store.copy_journal()
    store.drop(listed.gone)
    files = iter(progress(listed.unknown, len(listed.unknown)))
    while batch := list(islice(files, _BATCH)):
        rows = []
        for file in batch:
            rows.append(row_of(store.root, file))
            rest()
        store.put(rows)
    store.settle(listed.settled)
    store.copy_labels()
    return len(listed.unknown)


def _walk(root: Path, folder: str, settled: dict[str, Stamp]) -> Iterator[tuple[str, Stamp, bool]]:
    """The folder and all those in it: the way down from ``root``, its times, and whether there are none in it.

    The times are those before it is listed. In a settled one there are none.
    """
    stamp, inside = _stamp(root / folder), []
    if settled.get(folder) != stamp:
        with reading(root / folder), os.scandir(root / folder) as found:
            inside = [os.path.join(folder, one.name) for one in found if one.is_dir(follow_symlinks=False)]
    yield folder, stamp, not inside
    for one in sorted(inside):
        if not one.endswith((".mcap", PART)):
            yield from _walk(root, one, settled)


def _compare(store: Store, folder: str, found: Listing) -> None:
    """List one folder."""
    known = store.known(folder) if _is_text(folder) else {}
    for file in _files(store.root, folder):
        if not _is_text(file.path):
            found.nameless.append(file)
        elif file.name.endswith(PART):
            found.torn.append(file)
        elif known.pop(file.name, None) != (file.bytes, file.mtime_ns):
            found.unknown.append(file)
    if known:
        found.gone[folder] = list(known)


def _files(root: Path, folder: str) -> Iterator[File]:
    with reading(root / folder), os.scandir(root / folder) as entries:
        for entry in entries:
            if entry.name.endswith((".mcap", f".mcap{PART}")):
                try:
                    said = entry.stat()
                except OSError:  # deleted meanwhile, or a link to nothing
                    continue
                yield File(folder, entry.name, said.st_size, said.st_mtime_ns)


def _stamp(folder: Path) -> Stamp:
    with reading(folder):
        said = os.stat(folder)
    return Stamp(said.st_mtime_ns, said.st_ctime_ns)


def _is_below(folder: str, below: str) -> bool:
    return not below or folder == below or folder.startswith(f"{below}/")


def _is_text(name: str) -> bool:
    """Whether SQLite can hold it."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True
