"""The folder of a data set: it appears under its name when it is complete, and not before."""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bus.atomic import sync_folder
from bus.errors import ConfigError, RecordingError
from logs.mcap.names import shown
from logs.mcap.recorder import PART

_MARK = ".vlad-cell-export"
"""File that says of a ``.part`` folder that an export made it, and that it may be deleted."""


@contextmanager
def new_folder(target: Path) -> Iterator[Path]:
    """A folder to write into, ``target.part``: it becomes ``target`` when the block ends.

    When the block raises, nothing is left. What a killed export left is deleted by the next one of the same name.

    Raises: ConfigError when ``target`` exists, or another export writes it; RecordingError when it cannot be written.
    """
    target = Path(os.path.abspath(target))
    part = target.with_name(target.name + PART)
    try:
        _refuse_existing(target)
        target.parent.mkdir(parents=True, exist_ok=True)
        lock = _begun(part)
        try:
            yield part
            (part / _MARK).unlink()
            _refuse_existing(target)
            os.rename(part, target)
        except BaseException:
            shutil.rmtree(part, ignore_errors=True)
            raise
        finally:
            os.close(lock)
        sync_folder(target.parent)
    except OSError as error:
        why = error.strerror or error
        raise RecordingError(
            f"{shown(target)} cannot be written: {why}.", "Check the disk, and who may write there."
        ) from error


def _refuse_existing(target: Path) -> None:
    if os.path.lexists(target):
        raise ConfigError(f"{shown(target)} exists already.", "Name another folder, or delete it first.")


def _begun(part: Path) -> int:
    """Make the folder, empty and marked; return its locked file descriptor."""
    if os.path.lexists(part) and not (part / _MARK).is_file():
        raise ConfigError(f"{shown(part)} exists, and no export made it.", "Move it away, or name another folder.")
    part.mkdir(exist_ok=True)
    lock = os.open(part, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(lock)
        raise ConfigError(f"Another export writes {shown(part)}.", "Wait for it, or name another folder.") from error
    (part / _MARK).touch()
    for left in part.iterdir():
        if left.is_dir():
            shutil.rmtree(left)
        elif left.name != _MARK:
            left.unlink()
    return lock
