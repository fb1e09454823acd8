"""Answers a person's own query. It can only read, and no longer and no more than it may."""

from __future__ import annotations

import sqlite3
import time
from contextlib import closing
from typing import Any, NamedTuple

from bus.errors import CatalogueError
from logs.catalogue.catalogue import Catalogue
from logs.catalogue.store import Store, asking

MAX_ROWS, MAX_S = 100_000, 10.0
_STEPS = 10_000
"""Steps of SQLite's machine between two looks at the clock: a millisecond or so."""
_MAX_VALUE_BYTES = 10_000_000
_MAX_SQL_BYTES = 100_000
_ALLOWED = frozenset({sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ, sqlite3.SQLITE_RECURSIVE})
_REFUSED_FUNCTIONS = frozenset({"load_extension", "writefile", "readfile", "edit", "fts3_tokenizer"})
_TABLES_OF_FUNCTIONS = ("json_each", "json_tree")
_ADVICE = "One SELECT of the table `cycles` or `labels`: docs/catalogue.md."


class Answer(NamedTuple):
    """The answer to a query: the names of its columns, and its rows."""

    columns: tuple[str, ...]
    rows: list[tuple[Any, ...]]


def ask(catalogue: Catalogue, sql: str, *, max_rows: int = MAX_ROWS, max_s: float = MAX_S) -> Answer:
    """Answer one SELECT.

    Raises: CatalogueError when it is none, would do anything but read, is wrong, or is beyond ``max_rows`` rows or
        ``max_s`` seconds; the catalogue is unchanged.
    """
    with closing(_reader(catalogue.store, max_s)) as connection:
        return asked(connection, sql, max_rows, max_s)


def asked(connection: sqlite3.Connection, sql: str, max_rows: int, max_s: float) -> Answer:
    """Return the answer of a connection, which from then on can only read. Raises: CatalogueError, as `ask`."""
    connection.execute("PRAGMA query_only = ON")
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MAX_VALUE_BYTES)
    connection.setlimit(sqlite3.SQLITE_LIMIT_SQL_LENGTH, _MAX_SQL_BYTES)
    connection.setlimit(sqlite3.SQLITE_LIMIT_ATTACHED, 0)
    for table in _TABLES_OF_FUNCTIONS:  # made at its first use, which the authorizer would refuse
        connection.execute(f"SELECT 1 FROM {table}('[]')")
    connection.set_authorizer(_authorize)
    give_up_s = time.monotonic() + max_s
    connection.set_progress_handler(lambda: time.monotonic() > give_up_s, _STEPS)
    return _answered(connection, sql, max_rows, max_s)


def _answered(connection: sqlite3.Connection, sql: str, max_rows: int, max_s: float) -> Answer:
    try:
        cursor = connection.execute(sql)
        rows = cursor.fetchmany(max_rows + 1)
    except sqlite3.Error as error:
        raise _refusal(error, max_s) from error
    except (sqlite3.Warning, UnicodeEncodeError, ValueError) as error:
        raise CatalogueError(f"The query is refused: {error}", _ADVICE) from error
    if cursor.description is None:
        raise CatalogueError("The query says nothing.", _ADVICE)
    if len(rows) > max_rows:
        raise CatalogueError(f"The query has more than {max_rows} rows.", "Add a LIMIT, or raise --rows.")
    return Answer(tuple(one[0] for one in cursor.description), rows)


def _refusal(error: sqlite3.Error, max_s: float) -> CatalogueError:
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    if code == sqlite3.SQLITE_INTERRUPT:
        return CatalogueError(f"The query took longer than {max_s:g} s.", "Ask for less, or raise --seconds.")
    if code in (sqlite3.SQLITE_AUTH, sqlite3.SQLITE_READONLY):
        return CatalogueError(f"The query is refused, because it does more than read: {error}.", _ADVICE)
    if code == sqlite3.SQLITE_TOOBIG:
        return CatalogueError("The query makes values that are too large.", _ADVICE)
    return CatalogueError(f"The query cannot be answered: {error}.", _ADVICE)


def _authorize(action: int, first: str | None, second: str | None, _database: str | None, _by: str | None) -> int:
    """Allow what reads; no ATTACH, PRAGMA, transaction or change, and no function that reaches out of the database."""
    if action == sqlite3.SQLITE_FUNCTION:
        is_refused = (second or "").lower() in _REFUSED_FUNCTIONS
        return sqlite3.SQLITE_DENY if is_refused else sqlite3.SQLITE_OK
    return sqlite3.SQLITE_OK if action in _ALLOWED else sqlite3.SQLITE_DENY


def _reader(store: Store, patience_s: float) -> sqlite3.Connection:
    """A connection of its own: to the file, which it cannot write, or to a copy of what is in memory."""
    with asking(store.path):
        if not store.is_in_memory:
            return sqlite3.connect(f"{store.path.absolute().as_uri()}?mode=ro", uri=True, timeout=patience_s)
        connection = sqlite3.connect(":memory:")
        store.connection.backup(connection)
        return connection
