"""Writes a file atomically: after a power cut either the old or the new content is there, complete."""

from __future__ import annotations

import errno
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

_NEW_MODE = 0o644


def write_atomically(path: Path, data: bytes, *, mode: int | None = None) -> None:
    """Replace the content of ``path`` with ``data``; a symbolic link stays, and its target is written.

    Args:
        mode: permission bits, independent of the umask; None keeps those of the replaced file (0644 for a new one).

    Raises:
        OSError: the file is unchanged, and no temporary file is left.
    """
    with written_atomically(path, mode=mode) as output:
        output.write(data)


@contextmanager
def written_atomically(path: Path, *, mode: int | None = None) -> Iterator[IO[bytes]]:
    """A file to write what is too large to be held: it becomes ``path``, as above, when the block ends.

    Raises: OSError; then, and when the block raises, the file is as it was, and nothing else is left.
    """
    target = os.path.realpath(path)
    folder = os.path.dirname(target)
    try:
        file, part = tempfile.mkstemp(prefix=".write-", dir=folder)  # a fixed name (path + ".part") may exist already
    except OSError as error:
        error.filename = target  # nobody knows the other name
        raise
    try:
        with os.fdopen(file, "wb") as output:
            yield output
            _keep_owner_and_mode(output.fileno(), target, mode)
            output.flush()
            os.fsync(output.fileno())
        os.replace(part, target)
    except BaseException:
        os.unlink(part)
        raise
    sync_folder(Path(folder))


def sync_folder(folder: Path) -> None:
    """Make the names in ``folder`` durable: until then a power cut may undo a rename. Raises: OSError."""
    listing = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(listing)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # a network file system that cannot sync a folder
            raise
    finally:
        os.close(listing)


def _keep_owner_and_mode(file: int, target: str, mode: int | None) -> None:
    try:
        before = os.stat(target)
    except FileNotFoundError:
        os.fchmod(file, _NEW_MODE if mode is None else mode)
        return
    with suppress(PermissionError):  # only root may change a file's owner; other users keep the new file
        os.fchown(file, before.st_uid, before.st_gid)
    os.fchmod(file, stat.S_IMODE(before.st_mode) if mode is None else mode)
