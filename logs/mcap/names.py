"""Printable names of recordings, and the mapping of read errors to RecordingError."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bus.errors import CellError, RecordingError
from logs.mcap.records import Damage


def shown(path: Path) -> str:
    """Return the path as one printable line, whatever bytes its name contains."""
    return printable(os.fsencode(path).decode("utf-8", "backslashreplace"))


def printable(text: str) -> str:
    """Return the text as one line."""
    return "".join(one if one.isprintable() else one.encode("unicode_escape").decode() for one in text)


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Context in which ``path`` is read. Raises: RecordingError for errors of the file."""
    try:
        yield
    except Damage as error:
        raise RecordingError(
            f"{shown(path)} is damaged or no MCAP: {error}.",
            "Copy it again from where it was recorded; or keep what can be read of it: `cell recover`.",
        ) from error
    except OSError as error:
        raise RecordingError(
            f"{shown(path)} cannot be read: {error.strerror or error}.", "Check the name, and who may read it."
        ) from error


@contextmanager
def telling(what: str) -> Iterator[None]:
    """Context in which recorded values are put into text and figures. Raises: RecordingError for unsuitable values."""
    try:
        yield
    except CellError:
        raise
    except Exception as error:
        line = shown(Path(f"{type(error).__name__}: {error}"))
        raise RecordingError(
            f"{what} cannot be told: {line}.", "What it holds makes no sense; look at it raw."
        ) from error


def is_folder(path: Path) -> bool:
    """True for a folder. Raises: RecordingError when that cannot be determined."""
    with reading(path):
        return path.is_dir()


def found_below(folder: Path, pattern: str) -> list[Path]:
    """Return the files below ``folder`` whose names match, sorted by path. Raises: RecordingError."""
    with reading(folder):
        os.listdir(folder)  # raises; `rglob` silently finds nothing without permission
        return sorted(folder.rglob(pattern))
