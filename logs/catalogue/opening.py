"""Opens the catalogue for writing: makes it, sets aside one that cannot be used, or keeps it in memory."""

from __future__ import annotations

import fcntl
import os
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

from bus.errors import CatalogueError
from logs.catalogue.columns import SCHEMA, TABLES
from logs.catalogue.store import CATALOGUE, DamagedCatalogue, Store, asking
from logs.mcap.recorder import MODE

DAMAGED, OLDER = ".damaged", ".older"
"""Appended to the name of a catalogue that is set aside; a later one replaces it."""
_LOCK = ".catalogue.lock"
_BUSY_S = 5.0
_WITH_IT = ("", "-wal", "-shm")

Tell = Callable[[str], None]


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
