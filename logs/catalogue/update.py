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
from logs.catalogue.store import CATALOGUE, Store
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
    """The folder of recordings that a folder belongs to, and the way down to it.

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
        gone: names of rows without a file, by folder. ``settled``: time [ns] of every folder that was listed, None
            where it, or one in it, may change without another time. (Of a settled one only settled ones are visited.)
    """

    unknown: list[File]
    torn: list[File]
    nameless: list[File]
    gone: dict[str, list[str]]
    settled: dict[str, int | None]

    def pairs_gone(self) -> set[tuple[str, str]]:
        """Folder and name of every row without a file."""
        return {(folder, name) for folder, names in self.gone.items() for name in names}


def listing(store: Store, below: str = "", *, thorough: bool = False) -> Listing:
    """Compare the folders with the rows; folders that have not changed are not listed again. Raises: RecordingError.

    Args:
        below: only this folder and those in it.
        thorough: list every folder: a file that was overwritten in place does not change its folder.
    """
    found = Listing([], [], [], {}, {})
    settled = {} if thorough else store.folders()
    visited = set()
    for folder in _walk(store.root, below, settled):
        visited.add(folder)
        mtime_ns = _mtime_ns(store.root / folder)
        if settled.get(folder) != mtime_ns:
            _compare(store, folder, mtime_ns, found)
    for folder in [one for one, mtime_ns in found.settled.items() if mtime_ns is None]:
        found.settled.update(dict.fromkeys(_above(folder)))
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


def _walk(root: Path, below: str, settled: dict[str, int]) -> Iterator[str]:
    """The folder and all those in it, the way down from ``root``; of a settled one the known ones."""
    folder = below
    yield folder
    if settled.get(folder) == _mtime_ns(root / folder):
        inside = [one for one in settled if one and os.path.dirname(one) == folder]
    else:
        with reading(root / folder), os.scandir(root / folder) as found:
            inside = [os.path.join(folder, one.name) for one in found if one.is_dir(follow_symlinks=False)]
    for one in sorted(inside):
        if not one.endswith((".mcap", PART)):
            yield from _walk(root, one, settled)


def _above(folder: str) -> Iterator[str]:
    """The folders that this one is in, up to the root, which is ""."""
    while folder:
        folder = os.path.dirname(folder)
        yield folder


def _compare(store: Store, folder: str, mtime_ns: int, found: Listing) -> None:
    """List one folder."""
    known = store.known(folder) if _is_text(folder) else {}
    torn = len(found.torn) + len(found.nameless)
    for file in _files(store.root, folder):
        if not _is_text(file.path):
            found.nameless.append(file)
        elif file.name.endswith(PART):
            found.torn.append(file)
        elif known.pop(file.name, None) != (file.bytes, file.mtime_ns):
            found.unknown.append(file)
    if known:
        found.gone[folder] = list(known)
    is_settled = time.time_ns() - mtime_ns > _SETTLED_NS and torn == len(found.torn) + len(found.nameless)
    if _is_text(folder):
        found.settled[folder] = mtime_ns if is_settled else None


def _files(root: Path, folder: str) -> Iterator[File]:
    with reading(root / folder), os.scandir(root / folder) as entries:
        for entry in entries:
            if entry.name.endswith((".mcap", f".mcap{PART}")):
                try:
                    said = entry.stat()
                except OSError:  # deleted meanwhile, or a link to nothing
                    continue
                yield File(folder, entry.name, said.st_size, said.st_mtime_ns)


def _mtime_ns(folder: Path) -> int:
    with reading(folder):
        return os.stat(folder).st_mtime_ns


def _is_below(folder: str, below: str) -> bool:
    return not below or folder == below or folder.startswith(f"{below}/")


def _is_text(name: str) -> bool:
    """Whether SQLite can hold it."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True
