"""Makes the row of a deleted recording from its line in the journal."""

from __future__ import annotations

import os

from logs.catalogue.column import Value, stored
from logs.catalogue.columns import COLUMNS, NAMES
from logs.catalogue.journal import Gone


def row_of_deleted(gone: Gone) -> tuple[Value, ...]:
    """Return the values in the order of `columns.NAMES`; what an older program did not know yet is NULL."""
    said = {**gone.row, "deleted_ns": gone.at_ns, "deleted_by": gone.why, "archived": gone.archived or None}
    folder, name = os.path.split(gone.file)
    sizes = (_number(gone.row.get("bytes")), _number(gone.row.get("mtime_ns")))
    return (stored(gone.file), stored(folder), stored(name), *sizes, *(stored(said.get(one.name)) for one in COLUMNS))


def row_for_journal(row: tuple[Value, ...]) -> dict[str, Value]:
    """Return what the journal keeps of a row: all that is known, without what its line says itself."""
    return {name: value for name, value in zip(NAMES, row, strict=True) if value is not None and name not in _OF_LINE}


_OF_LINE = ("file", "folder", "name", "deleted_ns", "deleted_by", "archived")


def _number(value: Value) -> int:
    kept = stored(value)
    return kept if isinstance(kept, int) else 0
