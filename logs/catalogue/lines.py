"""Small files beside the recordings to which only whole lines are appended: one JSON object each."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from bus.errors import CatalogueError
from logs.mcap.recorder import MODE


def append_line(path: Path, line: bytes) -> None:
    """Append one line, synced to the disk; what a power cut left of the line before is ended. Raises: CatalogueError.

    What cannot be written whole, e.g. on a full disk, is taken back.
    """
    try:
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, MODE)
        try:
            fcntl.flock(file, fcntl.LOCK_EX)
            size = os.fstat(file).st_size
            is_torn = size > 0 and os.pread(file, 1, size - 1) != b"\n"
            said = b"\n" * is_torn + line + b"\n"
            if os.write(file, said) < len(said):
                os.ftruncate(file, size)
                raise OSError(None, "the disk is full")
            os.fsync(file)
        finally:
            os.close(file)
    except OSError as error:
        raise CatalogueError(
            f"{path} cannot be written: {error.strerror}.", "Check the disk's space, and who may write there."
        ) from error
