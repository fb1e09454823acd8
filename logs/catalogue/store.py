"""The file of the catalogue: SQLite in WAL mode beside the recordings, so that it is read while it is written.

It is derived: one that is damaged, or of another version of this program, is renamed and made anew.
"""

from __future__ import annotations

import fcntl
import os
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path

from bus.errors import CatalogueError
from logs.catalogue.column import Value
from logs.catalogue.columns import LABEL_COLUMNS, NAMES, SCHEMA, TABLES
from logs.catalogue.labels import LABELS, read_labels
from logs.mcap.recorder import MODE

CATALOGUE = "catalogue.sqlite"
DAMAGED, OLDER = ".damaged", ".older"
"""Appended to the name of a catalogue that is set aside; a later one replaces it."""
_LOCK = ".catalogue.lock"
_BUSY_S = 5.0
_WITH_IT = ("", "-wal", "-shm")
_PUT = f"INSERT OR REPLACE INTO cycle ({', '.join(NAMES)}) VALUES ({', '.join('?' * len(NAMES))})"
_PUT_LABEL = f"INSERT INTO labels VALUES ({', '.join('?' * len(LABEL_COLUMNS))})"

Tell = Callable[[str], None]


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
        """Remove the rows of files that are not there any more: their names by folder."""
        if not gone:
            return
        with self._transaction() as connection:
            pairs = [(folder, name) for folder, names in gone.items() for name in names]
            connection.executemany("DELETE FROM cycle WHERE folder = ? AND name = ?", pairs)

    def forget(self) -> None:
        """Remove all rows."""
        with self._transaction() as connection:
            connection.execute("DELETE FROM cycle")
            connection.execute("DELETE FROM folders")

    def known(self, folder: str) -> dict[str, tuple[int, int]]:
        """Size and time [ns] of every file of a folder that has a row, by its name."""
        with asking(self.path):
            rows = self.connection.execute("SELECT name, bytes, mtime_ns FROM cycle WHERE folder = ?", (folder,))
            return {name: (size, mtime_ns) for name, size, mtime_ns in rows}

    def folders(self) -> dict[str, int]:
        """The folders that need not be listed while their time [ns] is this."""
        with asking(self.path):
            return dict(self.connection.execute("SELECT folder, mtime_ns FROM folders"))

    def folders_with_rows(self) -> list[str]:
        """The folders of all rows."""
        with asking(self.path):
            return [folder for (folder,) in self.connection.execute("SELECT DISTINCT folder FROM cycle")]

    def settle(self, folders: Mapping[str, int | None]) -> None:
        """Remember that the rows are those of each folder at that time [ns]; None = forget it."""
        was = self.folders()
        changed = [(folder, mtime_ns) for folder, mtime_ns in folders.items() if was.get(folder) != mtime_ns]
        if not changed:
            return
        with self._transaction() as connection:
            connection.executemany("DELETE FROM folders WHERE folder = ?", [(folder,) for folder, _ in changed])
            connection.executemany("INSERT INTO folders VALUES (?, ?)", [one for one in changed if one[1] is not None])

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


def open_store(root: Path, tell: Tell = lambda _: None) -> Store:
    """Open the catalogue of a folder of recordings for writing; make it, also in place of one that cannot be used.

    Args:
        tell: told in words what was set aside.

    Raises: CatalogueError when the folder cannot be written.
    """
    path = root / CATALOGUE
    with _alone(root):
        try:
            return Store(path, _connected(path))
        except DamagedCatalogue as error:
            tell(f"{error.text} It is kept as {_set_aside(path, DAMAGED).name}, and made anew.")
        except _OtherVersion:
            tell(f"{path} is of another version: it is kept as {_set_aside(path, OLDER).name}, and made anew.")
        return Store(path, _connected(path))


def in_memory(root: Path) -> Store:
    """A catalogue in memory, with the rows of the file where that can be read: for a folder that cannot be written."""
    path = root / CATALOGUE
    connection = sqlite3.connect(":memory:", isolation_level=None)
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)) as kept:
            if kept.execute("PRAGMA user_version").fetchone() == (SCHEMA,):
                kept.backup(connection)
    except sqlite3.Error:
        connection.close()
        connection = sqlite3.connect(":memory:", isolation_level=None)
    with asking(path):
        if connection.execute("PRAGMA user_version").fetchone() != (SCHEMA,):
            _create(connection)
    return Store(path, connection, is_in_memory=True)


def check(root: Path) -> None:
    """Read the whole file. Raises: DamagedCatalogue, CatalogueError."""
    path = root / CATALOGUE
    with asking(path), closing(sqlite3.connect(path, timeout=_BUSY_S)) as connection:
        (said,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    if said != "ok":
        raise DamagedCatalogue(f"{path} is damaged: {said}.", "`cell catalogue rebuild` makes it anew.")


def set_aside(root: Path) -> Path:
    """Rename a damaged catalogue; the next opening makes a new one. Raises: CatalogueError."""
    with _alone(root):
        return _set_aside(root / CATALOGUE, DAMAGED)


class _OtherVersion(Exception):
    """The catalogue has other columns."""


def _connected(path: Path) -> sqlite3.Connection:
    """Raises: DamagedCatalogue, _OtherVersion, CatalogueError."""
    with asking(path):
        connection = sqlite3.connect(path, timeout=_BUSY_S, isolation_level=None)
        try:
            (version,) = connection.execute("PRAGMA user_version").fetchone()
            if version == 0 and not connection.execute("SELECT 1 FROM sqlite_master").fetchone():
                os.chmod(path, MODE)
                connection.execute("PRAGMA journal_mode = WAL")
                _create(connection)
            elif version != SCHEMA:
                raise _OtherVersion
            connection.execute("PRAGMA synchronous = FULL")
        except BaseException:
            connection.close()
            raise
        return connection


def _create(connection: sqlite3.Connection) -> None:
    connection.executescript(f"BEGIN IMMEDIATE; {TABLES} PRAGMA user_version = {SCHEMA}; COMMIT;")


def _set_aside(path: Path, suffix: str) -> Path:
    aside = path.with_name(path.name + suffix)
    try:
        for part in _WITH_IT:
            with suppress(FileNotFoundError):
                os.unlink(f"{aside}{part}")
            with suppress(FileNotFoundError):
                os.rename(f"{path}{part}", f"{aside}{part}")
    except OSError as error:
        raise CatalogueError(
            f"{path} cannot be renamed: {error.strerror}.", "Delete it; it is made anew from the recordings."
        ) from error
    return aside


@contextmanager
def _alone(root: Path) -> Iterator[None]:
    """Context in which no other process opens, makes or renames the catalogue. Raises: CatalogueError."""
    try:
        file = os.open(root / _LOCK, os.O_RDWR | os.O_CREAT, MODE)
    except OSError as error:
        raise CatalogueError(
            f"No catalogue can be written in {root}: {error.strerror}.", "Check who may write there."
        ) from error
    try:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
    finally:
        os.close(file)


def _inode(path: Path) -> int | None:
    try:
        return os.stat(path).st_ino
    except OSError:
        return None
