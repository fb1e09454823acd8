"""A recording's file in words, and what is wrong with it as the one error that its readers raise."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bus.errors import CellError, RecordingError
from logs.mcap.records import Damage


def shown(path: Path) -> str:
    """The path as one line that can be printed, whatever bytes its name is of."""
    return printable(os.fsencode(path).decode("utf-8", "backslashreplace"))


def printable(text: str) -> str:
    """The text as one line."""
    return "".join(one if one.isprintable() else one.encode("unicode_escape").decode() for one in text)


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Inside, ``path`` is read. Raises: RecordingError for what is wrong with it."""
    try:
        yield
    except Damage as error:
        raise RecordingError(
            f"{shown(path)} is damaged or no MCAP: {error}.", "Copy it again from where it was recorded."
        ) from error
    except OSError as error:
        raise RecordingError(
            f"{shown(path)} cannot be read: {error.strerror or error}.", "Check the name, and who may read it."
        ) from error


@contextmanager
def telling(what: str) -> Iterator[None]:
    """Inside, what was recorded is put into words and pictures. Raises: RecordingError for values that forbid it."""
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
    """Raises: RecordingError when that cannot be known."""
    with reading(path):
        return path.is_dir()


def found_below(folder: Path, pattern: str) -> list[Path]:
    """The files below ``folder`` whose name fits, in the order of their paths. Raises: RecordingError."""
    with reading(folder):
        os.listdir(folder)  # `rglob` finds nothing, silently, where it may not look
        return sorted(folder.rglob(pattern))
