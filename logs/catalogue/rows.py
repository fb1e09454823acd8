"""Makes the row of one recording."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

from bus.errors import RecordingError
from logs.catalogue.column import Told, Value, stored
from logs.catalogue.columns import COLUMNS
from logs.catalogue.cycle_columns import day_of, stamp_ns
from logs.mcap.index import read_entry
from logs.mcap.names import reading, shown, telling
from logs.mcap.reader import CycleRecord, read_stages


class File(NamedTuple):
    """One recording as its folder lists it.

    Attributes:
        folder: below the folder of recordings, "" for that itself. ``mtime_ns``: UTC.
    """

    folder: str
    name: str
    bytes: int
    mtime_ns: int

    @property
    def path(self) -> str:
        """Below the folder of recordings."""
        return os.path.join(self.folder, self.name)


def file_of(path: Path, root: Path) -> File:
    """Return the file as it is now. Raises: RecordingError when it is not there, or not below ``root``."""
    with reading(path):
        found = path.stat()
        below = os.path.relpath(path.resolve().parent, root.resolve())
    if below.startswith(os.pardir):
        raise RecordingError(f"{path} does not lie in {root}.", "A catalogue holds what lies beside it.")
    return File("" if below == os.curdir else below, path.name, found.st_size, found.st_mtime_ns)


def row_of(root: Path, file: File) -> tuple[Value, ...]:
    """Return the values of one recording, in the order of `columns.NAMES`; errors of the file become part of it."""
    path = root / file.path
    try:
        values = values_of(read_stages(path))
    except RecordingError as error:
        values = _outcome(path, error.text.removeprefix(f"{shown(path)} "))
    return (file.path, *file[:2], *file[2:], *(values.get(column.name) for column in COLUMNS))


def values_of(record: CycleRecord) -> dict[str, Value]:
    """Return each column's value by name (`columns.COLUMNS`). Raises: RecordingError for inconsistent values."""
    told = Told(record)
    with telling(f"The cycle {record.cycle_id!r}"):
        return {column.name: stored(column.take(told)) for column in COLUMNS}


def _outcome(path: Path, why: str) -> dict[str, Value]:
    """Return what can be said of a recording whose stages cannot be read."""
    entry = read_entry(path)
    started_ns = stamp_ns(entry.cycle_id)
    values: dict[str, Value] = {
        "cycle_id": entry.cycle_id,
        "began": entry.began,
        "started_ns": started_ns,
        "day": day_of(started_ns),
        "result": entry.result,
        "code": entry.code,
        "reason": entry.reason,
        "object": entry.object,
        "wall_s": entry.wall_s,
        "number": entry.number,
        "retry_of": entry.retry_of,
        "retried_as": entry.retried_as,
        "asked_by": entry.asked_by,
        "unread": why,
    }
    return {name: stored(value) for name, value in values.items()}
