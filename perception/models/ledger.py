"""The ledger of hosted models' costs: one JSON object a line. It stays readable after a power cut."""

from __future__ import annotations

import errno
import fcntl
import json
import logging
import math
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import date, datetime
from pathlib import Path

from bus.atomic import sync_folder
from bus.errors import RecordingError

_TORN = ".torn"
_PADDING = b" \t\r\0"
"""Bytes ignored around a line: a file system may leave zeros after a power cut."""
_DAY = re.compile(rb'"at"\s*:\s*"([0-9]{4}-[0-9]{2}-[0-9]{2})')
_AMOUNT = re.compile(rb'"usd"\s*:\s*([0-9]{1,9}(?:\.[0-9]{1,12})?)')

_log = logging.getLogger(__name__)


class Ledger:
    """Lines of ``{"at", "model", "usd"}``. Several processes may write to one ledger; each line stays whole.

    A torn last line is moved to a file beside it, and logged.

    Raises: RecordingError for a file that cannot be used.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        if self._torn():
            self._set_aside()

    def spent_on(self, day: date) -> float:
        """Return the sum of a UTC day [USD]. A damaged line counts with its readable amounts, if it names no other day.

        Raises: RecordingError when the file cannot be read.
        """
        lines = [line for line in self._bytes().split(b"\n") if line.strip(_PADDING)]
        entries = [(line, _entry(line)) for line in lines]
        damaged = [line for line, entry in entries if entry is None]
        if damaged:
            _log.warning("%s: %d damaged lines; what can be read in them counts.", self._path, len(damaged))
        whole_usd = sum(entry[1] for _, entry in entries if entry is not None and entry[0] == day.isoformat())
        return whole_usd + sum(_readable_usd(line, day.isoformat()) for line in damaged)

    def note(self, at: datetime, model: str, usd: float) -> None:
        """Append one line of ``usd`` [USD] and sync it to the disk. Raises: RecordingError."""
        line = json.dumps({"at": at.isoformat(timespec="seconds"), "model": model, "usd": round(usd, 6)})
        with self._errors("Cannot note spending in"):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            is_new = not self._path.exists()
            with _locked(self._path, os.O_RDWR | os.O_CREAT | os.O_APPEND) as file:
                _append(file, line.encode() + b"\n")
            if is_new:
                sync_folder(self._path.parent)

    def _torn(self) -> bytes:
        """The bytes after the last whole line."""
        rest = self._bytes().rpartition(b"\n")[2]
        return b"" if _entry(rest) is not None else rest

    def _bytes(self) -> bytes:
        if not self._path.exists():
            return b""
        with self._errors("Cannot read the spending ledger"):
            return self._path.read_bytes()

    def _set_aside(self) -> None:
        """Move a torn last line away, under the lock, so that it is not a line another process is writing."""
        aside = self._path.with_name(self._path.name + _TORN)
        with self._errors("Cannot mend the spending ledger"), _locked(self._path, os.O_RDWR) as file:
            torn = self._torn()
            if not torn:
                return
            with _locked(aside, os.O_RDWR | os.O_CREAT | os.O_APPEND) as beside:
                _append(beside, torn + b"\n")
            sync_folder(aside.parent)
            os.ftruncate(file, os.fstat(file).st_size - len(torn))
            os.fsync(file)
        _log.warning(
            "%s ends within a line, as after a power cut: its %d bytes do not count, and are kept in %s.",
            self._path,
            len(torn),
            aside,
        )

    @contextmanager
    def _errors(self, cannot: str) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise RecordingError(f"{cannot} {self._path}: {error.strerror}.", "Free it, or move it away.") from error


@contextmanager
def _locked(path: Path, flags: int) -> Iterator[int]:
    """Open a file, as a descriptor that no other process has locked."""
    file = os.open(path, flags, 0o666)
    try:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield file
    finally:
        os.close(file)


def _append(file: int, data: bytes) -> None:
    """Append all of ``data`` on a line of its own and sync it, or append nothing."""
    size = os.fstat(file).st_size
    begun = size > 0 and os.pread(file, 1, size - 1) != b"\n"
    data = b"\n" + data if begun else data
    try:
        if os.write(file, data) < len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        os.fsync(file)
    except OSError:
        os.ftruncate(file, size)
        raise


def _entry(line: bytes) -> tuple[str, float] | None:
    """Day and amount [USD] of a whole line; None for a line that is not one."""
    try:
        entry = json.loads(line.strip(_PADDING))
    except (ValueError, RecursionError):
        return None
    at, usd = (entry.get(name) for name in ("at", "usd")) if isinstance(entry, dict) else (None, None)
    if not isinstance(at, str) or isinstance(usd, bool) or not isinstance(usd, (int, float)):
        return None
    return (at[:10], float(usd)) if 0 <= usd < math.inf else None


def _readable_usd(line: bytes, day: str) -> float:
    """The amounts [USD] that can be read in a damaged line; 0 when it names another day."""
    days = {found.decode() for found in _DAY.findall(line)}
    return sum(map(float, _AMOUNT.findall(line))) if not days or day in days else 0.0
