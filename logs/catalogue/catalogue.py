"""The catalogue of a folder as its readers use it: brought up to date, then listed, summed up and asked."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from heapq import merge
from itertools import chain, islice
from pathlib import Path
from typing import Any

from bus.errors import CatalogueError, RecordingError
from logs.catalogue.columns import BY_AGE
from logs.catalogue.opening import Tell, check, in_memory, open_store, set_aside
from logs.catalogue.store import CATALOGUE, THERE, DamagedCatalogue, Store, asking
from logs.catalogue.update import Listing, Progress, listing, quietly, root_of, update
from logs.mcap.index import FINE, Entry, Filter, read_entry
from logs.mcap.names import is_folder, shown

_BY_AGE = f"NOT ({BY_AGE} >= ? AND {BY_AGE} < ?)", f"({BY_AGE} >= ? AND {BY_AGE} < ?)"
"""Cycles of before now, and then those of a time to come (`logs.mcap.index.Filter.to_come`)."""
_LISTED = (
    "folder, name, cycle_id, result, code, reason, object, wall_s, number, retry_of, retried_as,"
    " coalesce(asked_by, ''), coalesce(began, '')"
)
_READ_FIRST = 64
"""So many of the newest files without a row are read, and sorted by when they began; more come by their names."""


def _silent(_text: str) -> None:
    """Nothing is told."""


@dataclass(frozen=True)
class Catalogue:
    """An up-to-date catalogue.

    Attributes:
        folder: as it was asked for. ``below``: the way down to it from the folder of recordings, "" for that itself.
        made: how many rows were made to bring it up to date. ``listed``: what has no row, among others.
        is_made: up to date; else `entries` reads what has no row, and only that, as it comes to it.
    """

    store: Store
    folder: Path
    below: str
    made: int
    listed: Listing
    is_made: bool = True

    def entries(self, wanted: Filter | None = None) -> Iterator[Entry]:
        """Yield the selected recordings, newest first, each as `logs.mcap.index.read_entry` gives it."""
        wanted = (wanted or Filter()).at_one_time()
        unmade = () if self.is_made else self.listed.unknown
        files = (*self.listed.torn, *self.listed.nameless, *unmade)
        others = [self.folder / self._path(file.folder, file.name) for file in files]
        dated = sorted(filter(wanted.dates, others), key=lambda path: wanted.age(path.name), reverse=True)
        newest = sorted(map(read_entry, dated[:_READ_FIRST]), key=lambda entry: wanted.age(entry.by_age), reverse=True)
        read = filter(wanted.takes, chain(newest, map(read_entry, dated[_READ_FIRST:])))
        known = chain.from_iterable(self._known(wanted, which) for which in _BY_AGE)
        both = merge(known, read, key=lambda entry: wanted.age(entry.by_age), reverse=True) if dated else known
        return islice(both, wanted.last)

    def rows(self, sql: str, given: Sequence[Any] = ()) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of one of our own statements. Raises: CatalogueError."""
        with asking(self.store.path):
            yield from self.store.connection.execute(sql, given)

    def where(self, day: str = "") -> tuple[str, list[str]]:
        """Return the condition, with its values, for the cycles of this folder, and of a day or a prefix of one."""
        conditions, given = ["1"], []
        if self.below:
            conditions.append("(folder = ? OR folder LIKE ?)")
            given += [self.below, f"{self.below}/%"]
        if day:
            conditions.append("day >= ? AND day < ?")
            given += [day, f"{day}~"]
        return " AND ".join(conditions), given

    def _known(self, wanted: Filter, which: str) -> Iterator[Entry]:
        where, given = self.where()
        where, given = f"{where} AND {THERE} AND {which}", [*given, *wanted.to_come]
        if digits := wanted.digits:
            where, given = f"{where} AND name >= ? AND name < ?", [*given, digits, f"{digits}~"]
        if wanted.failed:
            where += f" AND result NOT IN ({', '.join('?' * len(FINE))})"
            given += FINE
        if wanted.code:
            where, given = f"{where} AND code = ?", [*given, wanted.code.upper()]
        stale = set() if self.is_made else {file[:2] for file in self.listed.unknown} | self.listed.pairs_gone()
        limit = "" if wanted.last is None or stale else f" LIMIT {wanted.last:d}"
        folders: dict[str, Path] = {}
        for folder, name, *values in self.rows(
            f"SELECT {_LISTED} FROM cycle WHERE {where} ORDER BY {BY_AGE} DESC{limit}", given
        ):
            if (folder, name) in stale:
                continue
            if folder not in folders:
                folders[folder] = self.folder / self._path(folder, "")
            yield Entry(folders[folder] / name, *values)

    def _path(self, folder: str, name: str) -> str:
        return os.path.relpath(os.path.join(folder, name), self.below) if self.below else os.path.join(folder, name)


@contextmanager
def open_catalogue(
    folder: Path,
    progress: Progress = quietly,
    tell: Tell = _silent,
    *,
    thorough: bool = False,
    anew: bool = False,
    most: int | None = None,
) -> Iterator[Catalogue]:
    """Open the catalogue of a folder of recordings, or of one of its days; it is made, or brought up to date.

    Where it cannot be written, it is made in memory, and lost in the end.

    Args:
        progress: shows how far it is. ``tell``: told what was set aside, and why nothing can be written.
        thorough: every file is looked at, and the whole catalogue is checked. ``anew``: all rows are made again.
        most: change nothing where more rows than so many lack, or for 0: for an answer that may not wait. None = make
            them all.

    Raises: RecordingError when the folder does not exist or cannot be read; CatalogueError.
    """
    if not is_folder(folder):
        raise RecordingError(
            f"There is no folder {shown(folder)}.", "Nothing was recorded yet, or name another folder."
        )
    root, below = root_of(folder)
    try:
        store, made, listed = _up_to_date(root, below, progress, tell, thorough=thorough, anew=anew, most=most)
    except DamagedCatalogue as error:
        tell(f"{error.text} It is kept as {set_aside(root).name}, and made anew.")
        store, made, listed = _up_to_date(root, below, progress, tell, most=most)
    except CatalogueError as error:
        tell(f"{error.text} What it lacks is read, and not kept.")
        store = in_memory(root)
        listed = listing(store, below)
        made = _made(store, listed, progress, most)
    with closing(store):
        yield Catalogue(store, folder, below, made or 0, listed, is_made=made is not None)


def _up_to_date(
    root: Path,
    below: str,
    progress: Progress,
    tell: Tell,
    *,
    thorough: bool = False,
    anew: bool = False,
    most: int | None = None,
) -> tuple[Store, int | None, Listing]:
    store = open_store(root, tell)
    try:
        if thorough:
            check(root)
        if anew:
            store.forget()
        listed = listing(store, below, thorough=thorough or anew)
        return store, _made(store, listed, progress, most), listed
    except BaseException:
        store.close()
        raise


def _made(store: Store, listed: Listing, progress: Progress, most: int | None) -> int | None:
    """How many rows were made to bring the catalogue up to date; None where more than ``most`` lack, and none was."""
    if most == 0 or (most is not None and len(listed.unknown) > most):
        return None
    return update(store, listed, progress)


def known_entries(folder: Path) -> Callable[[Path], Entry]:
    """Reads the entries of a folder's recordings: from its catalogue as it is, else from the file itself.

    Raises: nothing; a catalogue that cannot be read is not used.
    """
    root, below = root_of(folder)
    kept: dict[str, tuple[int, int, Entry]] = {}
    path = root / CATALOGUE
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=1.0)) as connection:
            found = connection.execute(f"SELECT bytes, mtime_ns, {_LISTED} FROM cycle WHERE folder = ?", (below,))
            for size, mtime_ns, _, name, *values in found:
                kept[name] = size, mtime_ns, Entry(folder / name, *values)
    except sqlite3.Error:
        kept = {}

    def read(recording: Path) -> Entry:
        size, mtime_ns, entry = kept.get(recording.name, (-1, -1, None))
        try:
            said = recording.stat()
        except OSError:
            return read_entry(recording)
        is_kept = entry is not None and (said.st_size, said.st_mtime_ns) == (size, mtime_ns)
        return entry if entry is not None and is_kept else read_entry(recording)

    return read
