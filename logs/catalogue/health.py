"""Checks of a catalogue that change nothing of it."""

from __future__ import annotations

import os
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from bus.errors import RecordingError
from logs.catalogue.columns import SCHEMA
from logs.catalogue.store import CATALOGUE, Store
from logs.catalogue.update import listing
from logs.mcap.index import recordings
from logs.mcap.recorder import PART


class Health(NamedTuple):
    """The state of a catalogue.

    Attributes:
        rows: how many it has. ``unread``: recordings that are new or have changed since. ``gone``: rows whose
            recording is not there. ``torn``: recordings that are not finished.
        trouble: why it cannot be used, "" when it can.
    """

    rows: int
    unread: int
    gone: int
    torn: int
    trouble: str = ""


def health(root: Path) -> Health:
    """Return the state of a folder's catalogue. Raises: RecordingError when either cannot be read."""
    path = root / CATALOGUE
    if not path.is_file():
        return _unusable(root, "it is missing")
    if not os.access(path, os.R_OK):
        raise RecordingError(f"You may not read {path}.", "Give yourself the right to read it.")
    # Nobody writes it without a -wal beside it; an ordinary reader would leave one there.
    how = "mode=ro" if path.with_name(f"{path.name}-wal").exists() else "immutable=1"
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?{how}", uri=True)) as connection:
            return _examined(root, path, connection)
    except sqlite3.Error as error:
        return _unusable(root, f"it is damaged: {error}")


def _examined(root: Path, path: Path, connection: sqlite3.Connection) -> Health:
    if connection.execute("PRAGMA user_version").fetchone() != (SCHEMA,):
        return _unusable(root, "it is of another version of this program")
    (said,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    if said != "ok":
        return _unusable(root, f"it is damaged: {said}")
    (rows,) = connection.execute("SELECT count(*) FROM cycle").fetchone()
    listed = listing(Store(path, connection))
    return Health(rows, len(listed.unknown), len(listed.pairs_gone()), len(listed.torn))


def _unusable(root: Path, trouble: str) -> Health:
    found = recordings(root)
    torn = sum(path.suffix == PART for path in found)
    return Health(0, len(found) - torn, 0, torn, trouble)
