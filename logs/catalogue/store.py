"""The file of the catalogue: SQLite in WAL mode beside the recordings, so that it is read while it is written.

It is derived: one that is damaged, or of another version of this program, is renamed and made anew.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from bus.errors import CatalogueError
from logs.catalogue.column import Value
from logs.catalogue.columns import LABEL_COLUMNS, NAMES
from logs.catalogue.deleted_row import row_of_deleted
from logs.catalogue.journal import Gone, journal_bytes, read_journal
from logs.catalogue.labels import LABELS, read_labels

CATALOGUE = "catalogue.sqlite"
THERE = "deleted_ns IS NULL"
"""Selects the rows whose recording is there."""
_BATCH = 1000
_PUT = f"INSERT OR REPLACE INTO cycle ({', '.join(NAMES)}) VALUES ({', '.join('?' * len(NAMES))})"
_PUT_LABEL = f"INSERT INTO labels VALUES ({', '.join('?' * len(LABEL_COLUMNS))})"


class Stamp(NamedTuple):
    """When a folder changed, UTC [ns]: what copies and programs set, and what they cannot set."""

    mtime_ns: int
    ctime_ns: int


class DamagedCatalogue(CatalogueError):
    """The file is no database, or a damaged one."""


@contextmanager
def asking(path: Path) -> Iterator[None]:
    """Context in which the catalogue is used. Raises: DamagedCatalogue, CatalogueError for errors of SQLite."""
    try:
        yield
    except sqlite3.Error as error:
        primary = getattr(error, "sqlite_errorcode", 0) & 0xFF
        if primary in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB):
            raise DamagedCatalogue(f"{path} is damaged: {error}.", "`cell catalogue rebuild` makes it anew.") from error
        raise CatalogueError(f"{path} cannot be used: {error}.", "Check the disk, and who may write there.") from error


class Store:
    """One connection that writes the catalogue; used by the thread that opened it. Its methods raise CatalogueError.

    Args:
        path: of the catalogue; its folder is that of the recordings.
        connection: to it, or to a copy in memory.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection, *, is_in_memory: bool = False) -> None:
        self.path, self.connection, self.is_in_memory = path, connection, is_in_memory
        self._inode = _inode(path)

    @property
    def root(self) -> Path:
        """The folder of recordings."""
        return self.path.parent

    def is_current(self) -> bool:
        """False when the file was deleted or replaced since it was opened."""
        return self._inode is not None and _inode(self.path) == self._inode

    def put(self, rows: Iterable[Sequence[Value]]) -> None:
        """Add rows, or replace those of the same files; all of them or none."""
        with self._transaction() as connection:
            connection.executemany(_PUT, rows)

    def drop(self, gone: Mapping[str, Iterable[str]]) -> None:
        """Take the rows of files that are not there any more, names by folder, from the journal; remove the others.

        The row of a file that is there stays, whoever says that it is gone.
        """
        named = ((folder, name) for folder, names in gone.items() for name in names)
        pairs = [pair for pair in named if not os.path.lexists(self.root.joinpath(*pair))]
        if not pairs:
            return
        with self._transaction() as connection:
            connection.executemany("DELETE FROM cycle WHERE folder = ? AND name = ?", pairs)
            files = [os.path.join(*pair) for pair in pairs]
            connection.executemany(_PUT, filter(None, (self._row_of_journal(connection, file) for file in files)))

    def forget(self) -> None:
        """Remove all rows."""
        with self._transaction() as connection:
            connection.execute("DELETE FROM cycle")
            connection.execute("DELETE FROM folders")
            connection.execute("DELETE FROM deletions")
            connection.execute("DELETE FROM journal")

    def known(self, folder: str) -> dict[str, tuple[int, int]]:
        """Size and time [ns] of every file of a folder that has a row and is not deleted, by its name."""
        with asking(self.path):
            rows = self.connection.execute(
                f"SELECT name, bytes, mtime_ns FROM cycle WHERE folder = ? AND {THERE}", (folder,)
            )
            return {name: (size, mtime_ns) for name, size, mtime_ns in rows}

    def folders(self) -> dict[str, Stamp]:
        """Return the folders that need not be listed while their times are these."""
        with asking(self.path):
            rows = self.connection.execute("SELECT folder, mtime_ns, ctime_ns FROM folders")
            return {folder: Stamp(*times) for folder, *times in rows}

    def folders_with_rows(self) -> list[str]:
        """Return the folders of all rows whose file is not deleted."""
        with asking(self.path):
            return [folder for (folder,) in self.connection.execute(f"SELECT DISTINCT folder FROM cycle WHERE {THERE}")]

    def settle(self, folders: Mapping[str, Stamp | None]) -> None:
        """Remember that the rows are those of each folder at those times; None = forget it."""
        was = self.folders()
        changed = [(folder, stamp) for folder, stamp in folders.items() if was.get(folder) != stamp]
        if not changed:
            return
        with self._transaction() as connection:
            connection.executemany("DELETE FROM folders WHERE folder = ?", [(folder,) for folder, _ in changed])
            kept = [(folder, *stamp) for folder, stamp in changed if stamp is not None]
            connection.executemany("INSERT INTO folders VALUES (?, ?, ?)", kept)

    def copy_labels(self) -> None:
        """Make the table of labels anew if their file has changed."""
        try:
            found = os.stat(self.root / LABELS)
            now: tuple[int, int] = found.st_size, found.st_mtime_ns
        except OSError:
            now = (0, 0)
        with asking(self.path):
            was = self.connection.execute("SELECT bytes, mtime_ns FROM labels_file").fetchone() or (0, 0)
        if was == now:
            return
        rows = [tuple(getattr(one, name) for name, _, _ in LABEL_COLUMNS) for one in read_labels(self.root)]
        with self._transaction() as connection:
            connection.execute("DELETE FROM labels")
            connection.execute("DELETE FROM labels_file")
            connection.executemany(_PUT_LABEL, rows)
            connection.execute("INSERT INTO labels_file VALUES (?, ?)", now)

    def copy_journal(self) -> None:
        """Read what was appended to the journal of deletions; make the rows of the files that have none."""
        with asking(self.path):
            (known,) = self.connection.execute("SELECT bytes FROM journal").fetchone() or (0,)
        size = journal_bytes(self.root)
        if known == size:
            return
        lines = read_journal(self.root, known if known < size else 0)
        while batch := list(islice(lines, _BATCH)):
            with self._transaction() as connection:
                self._add_lines(connection, [(at, gone) for at, _, gone in batch if gone is not None])
                connection.execute("DELETE FROM journal")
                connection.execute("INSERT INTO journal VALUES (?)", (batch[-1][1],))

    def _add_lines(self, connection: sqlite3.Connection, lines: Iterable[tuple[int, Gone]]) -> None:
        deleted = [(at, gone) for at, gone in lines if gone.what == "deleted"]
        connection.executemany(
            "INSERT OR REPLACE INTO deletions VALUES (?, ?)", [(one.file, at) for at, one in deleted]
        )
        rows = (row_of_deleted(gone) for _, gone in deleted if not os.path.lexists(self.root / gone.file))
        connection.executemany(_PUT, rows)

    def _row_of_journal(self, connection: sqlite3.Connection, file: str) -> tuple[Value, ...] | None:
        """The row of a deleted file; None for one that the journal does not name."""
        found = connection.execute("SELECT at FROM deletions WHERE file = ?", (file,)).fetchone()
        _, _, gone = next(read_journal(self.root, found[0]), (0, 0, None)) if found else (0, 0, None)
        return row_of_deleted(gone) if gone is not None and gone.file == file else None

    def close(self) -> None:
        """Close the connection; idempotent."""
        self.connection.close()

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        with asking(self.path):
            self.connection.execute("BEGIN IMMEDIATE")
            try:
                yield self.connection
                self.connection.execute("COMMIT")
            except BaseException:
                with suppress(sqlite3.Error):
                    self.connection.execute("ROLLBACK")
                raise


def _inode(path: Path) -> int | None:
    try:
        return os.stat(path).st_ino
    except OSError:
        return None
