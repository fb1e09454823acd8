"""Notes which settings of a station are read, and by whom: what nobody reads can have changed nothing."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from config.base import Settings

_AS_A_WHOLE = frozenset({"__dict__", "model_dump", "model_dump_json", "model_copy"})
"""Whoever asks a table for one of these may read all that is in it."""


class Reads:
    """The settings that were read.

    Attributes:
        reader: who reads now, set by whoever lets it work.
    """

    def __init__(self) -> None:
        self.reader = ""
        self._keys: dict[str, dict[str, None]] = {}  # with all below it; their readers, a set in order
        self._tables: dict[str, dict[str, None]] = {}  # on the way to one of them

    def note(self, key: str, *, is_table: bool) -> None:
        """Take that a setting was read, or that a table was on the way to one."""
        (self._tables if is_table else self._keys).setdefault(key, {})[self.reader] = None

    def of(self, key: str) -> tuple[str, ...]:
        """Who read the setting ``key``, a part of it, or the value that it is a part of."""
        above = ["", *(key[:end] for end in (*(place for place, one in enumerate(key) if one == "."), len(key)))]
        below = [known for known in (*self._keys, *self._tables) if known == key or known.startswith(f"{key}.")]
        found = {name: None for one in (*above, *below) for name in self._keys.get(one, {})}
        return tuple(found)


@contextmanager
def noted(station: Settings, reads: Reads) -> Iterator[None]:
    """Context in which what is read of this very station is noted. Other stations, and copies of it, are not.

    One context at a time in a process: another waits.
    """
    tables: dict[int, str] = {}
    _find_tables(station, "", tables)

    def noting(self: Settings, name: str) -> Any:
        value = super(Settings, self).__getattribute__(name)
        table = tables.get(id(self))
        if table is not None and not _unnoted.get():
            if name in _AS_A_WHOLE:
                reads.note(table, is_table=False)
            elif name in type(self).model_fields:
                reads.note(f"{table}.{name}" if table else name, is_table=isinstance(value, Settings))
        return value

    with _alone:
        Settings.__getattribute__ = noting  # type: ignore[method-assign, assignment]
        try:
            yield
        finally:
            del Settings.__getattribute__


@contextmanager
def unnoted() -> Iterator[None]:
    """Context in which reading decides nothing, and is not noted: that of a key for a cache."""
    token = _unnoted.set(True)
    try:
        yield
    finally:
        _unnoted.reset(token)


_alone = threading.Lock()
_unnoted: ContextVar[bool] = ContextVar("_unnoted", default=False)


def _find_tables(value: Any, key: str, tables: dict[int, str]) -> None:
    if isinstance(value, Settings):
        tables[id(value)] = key
        for name in type(value).model_fields:
            _find_tables(getattr(value, name), f"{key}.{name}" if key else name, tables)
