"""Answers a query over the Parquet exports of several cells: one table ``cycles``, in memory, of all their rows."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from bus.errors import CatalogueError
from logs.catalogue.ask import MAX_ROWS, MAX_S, Answer, asked
from logs.catalogue.export import parquet, pyarrow, require_pyarrow

_KEY = ("cell_id", "cycle_id")
_WHOLE_ROWS = re.compile(r"(?<!count\()\*", re.IGNORECASE)
_HOW = 'Make it with `cell query "SELECT * FROM cycles" --parquet FILE` on its cell.'


def ask_fleet(exports: Sequence[Path], sql: str, *, max_rows: int = MAX_ROWS, max_s: float = MAX_S) -> Answer:
    """Answer one SELECT of ``cycles``, as `logs.catalogue.ask.ask` does.

    Only the columns that the query names are read. What a cell of an older version has no column for is NULL. Of a
    cycle that is in several files the last one counts, in the order of their names.

    Args:
        exports: Parquet files, and folders of them. ``max_s``: for the query, once all is read.

    Raises: CatalogueError as `ask`, and by name for a file that is none, is of no cell, or holds what no catalogue
        does; ConfigError without pyarrow.
    """
    require_pyarrow()
    files = [file for path in exports for file in _files(path)]
    columns = {file: _columns(file) for file in files}
    wanted = [name for name in _known(columns) if name in _KEY or _names(sql, name)]
    with closing(sqlite3.connect(":memory:")) as connection:
        listed = ", ".join(f'"{name}"' for name in wanted)  # without a type: what is NULL all day has none in the file
        try:
            connection.execute(f"CREATE TABLE cycles ({listed}, PRIMARY KEY ({', '.join(_KEY)}))")
        except sqlite3.Error as error:
            named = ", ".join(map(str, files))
            raise CatalogueError(f"The columns of {named} are no table: {error}.", _HOW) from error
        for file in files:
            _fill(connection, file, [name for name in wanted if name in columns[file]])
        connection.commit()
        return asked(connection, sql, max_rows, max_s)


def _files(path: Path) -> Iterable[Path]:
    found = sorted(path.rglob("*.parquet")) if path.is_dir() else [path]
    if not found:
        raise CatalogueError(f"There is no Parquet file below {path}.", _HOW)
    return found


def _columns(file: Path) -> list[str]:
    """The columns of an export. Raises: CatalogueError."""
    try:
        schema = parquet.read_schema(file)
    except (OSError, ValueError, pyarrow.ArrowException) as error:
        raise CatalogueError(f"{file} cannot be read: {error}.", _HOW) from error
    if lacking := [name for name in _KEY if name not in schema.names]:
        raise CatalogueError(f"{file} has no column {lacking[0]}: nobody can say whose cycles these are.", _HOW)
    return [name for name in schema.names if '"' not in name and "\0" not in name]


def _known(columns: Mapping[Path, Sequence[str]]) -> Iterable[str]:
    """The columns of all files. Raises: CatalogueError for two whose names differ in case only, or not at all."""
    known: dict[str, str] = {}
    for file, names in columns.items():
        for name in names:
            if known.setdefault(name.lower(), name) != name or names.count(name) > 1:
                twice = f"{known[name.lower()]} and {name}"
                raise CatalogueError(f"{file}: SQL cannot tell the columns {twice} apart. Rename one.", _HOW)
    return known.values()


def _names(sql: str, column: str) -> bool:
    return _WHOLE_ROWS.search(sql) is not None or re.search(rf"\b{re.escape(column)}\b", sql, re.I) is not None


def _fill(connection: sqlite3.Connection, file: Path, names: Sequence[str]) -> None:
    """Add the rows of a file. Raises: CatalogueError."""
    listed, places = ", ".join(f'"{name}"' for name in names), ", ".join("?" * len(names))
    try:
        for batch in parquet.ParquetFile(file).iter_batches(columns=list(names)):
            values: list[list[Any]] = [batch.column(name).to_pylist() for name in names]
            rows = zip(*values, strict=True)
            connection.executemany(f"INSERT OR REPLACE INTO cycles ({listed}) VALUES ({places})", rows)
    except (sqlite3.Error, OverflowError) as error:
        raise CatalogueError(f"{file} has a value that is no number, text or bytes of SQL: {error}.", _HOW) from error
    except (OSError, ValueError, pyarrow.ArrowException) as error:
        raise CatalogueError(f"{file} cannot be read: {error}.", _HOW) from error
