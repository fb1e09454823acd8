"""Copies recordings to another place, any that fsspec reaches, and reads every copy back before it counts."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple

from bus.errors import ArchiveError, ConfigError
from bus.lazy import LazyModule
from logs.mcap.names import reading, shown

if TYPE_CHECKING:
    fsspec: Any
else:
    fsspec = LazyModule("fsspec.core")

_BLOCK_BYTES = 1 << 20
_PART = ".part"
_WITHOUT_FOLDERS = frozenset({"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "oss", "memory"})
"""Stores in which a name needs no folder; making one could make a bucket."""
_OPTIONS: dict[str, dict[str, Any]] = {
    "s3": {"config_kwargs": {"connect_timeout": 10, "read_timeout": 30, "retries": {"max_attempts": 2}}}
}
"""A daemon that ends waits for the copy that it makes."""


class Archived(NamedTuple):
    """One copy: its address, and the SHA-256 of what was read back from there."""

    address: str
    sha256: str


class Archive:
    """A place below an address of fsspec. A copy that was verified is never replaced.

    Args:
        address: ``s3://bucket/prefix``, ``file:///mnt/nas/cell-1``, a folder. Keys and endpoints of S3 are read from
            the environment, as every S3 client does.

        recordings: the folder of recordings; an archive in it would be pruned itself.

    Raises: ConfigError when a package is missing, the address is of no known kind, or lies among the recordings.
    """

    def __init__(self, address: str, recordings: Path | None = None) -> None:
        kind = address.partition("://")[0] if "://" in address else "file"
        try:
            self._fs, self._root = fsspec.url_to_fs(address, **_OPTIONS.get(kind, {}))
        except ImportError as error:
            raise ConfigError(
                f"The archive {address} needs a package that is not installed: {error}.",
                "Install vlad-cell[archive], and what fsspec names for other stores than S3.",
            ) from error
        except ValueError as error:
            raise ConfigError(
                f"{address!r} is no address of an archive: {error}.", "Correct recording.archive."
            ) from error
        if (
            kind == "file"
            and recordings is not None
            and Path(self._root).resolve().is_relative_to(recordings.resolve())
        ):
            raise ConfigError(
                f"The archive {address} lies among the recordings.", "Name another place, on another disk."
            )
        self._address, self._needs_folder = address.rstrip("/"), kind not in _WITHOUT_FOLDERS

    def put(self, path: Path, name: str) -> Archived:
        """Copy a file there under ``name``, and read it back; return what is there. One that is there is only compared.

        Raises: ArchiveError when it cannot be copied, what is read back differs, or another file has that name.
        """
        address = f"{self._address}/{name}"
        wanted = _hash_of_file(path)
        with _telling(path, address):
            there = f"{self._root.rstrip('/')}/{name}"
            self._fs.invalidate_cache()
            if self._fs.exists(there):
                self._require_equal(there, wanted, path, address, "Another file has that name; move it away.")
                return Archived(address, wanted)
            if self._needs_folder:
                self._fs.makedirs(there.rpartition("/")[0], exist_ok=True)
            self._copy(path, there, wanted, address)
        return Archived(address, wanted)

    def _copy(self, path: Path, there: str, wanted: str, address: str) -> None:
        """Under another name first, so that what has its name was read back. Raises: ArchiveError."""
        part = there + _PART
        self._fs.put_file(str(path), part)
        self._require_equal(part, wanted, path, address, "Check the archive; it is tried again.")
        self._fs.mv(part, there)
        self._fs.invalidate_cache()
        try:
            self._require_equal(there, wanted, path, address, "Check the archive; it is tried again.")
        except ArchiveError:
            self._fs.rm_file(there)
            raise

    def _require_equal(self, there: str, wanted: str, path: Path, address: str, advice: str) -> None:
        with self._fs.open(there, "rb") as file:
            if _hash_of(file) != wanted:
                raise ArchiveError(f"What is read back from {address} is not {shown(path)}, which stays.", advice)


def _hash_of_file(path: Path) -> str:
    with reading(path), path.open("rb") as file:
        return _hash_of(file)


def _hash_of(file: IO[bytes]) -> str:
    digest = hashlib.sha256()
    while block := file.read(_BLOCK_BYTES):
        digest.update(block)
    return digest.hexdigest()


@contextmanager
def _telling(path: Path, address: str) -> Iterator[None]:
    try:
        yield
    except ArchiveError:
        raise
    except Exception as error:
        what = str(error) or type(error).__name__
        raise ArchiveError(
            f"{shown(path)} cannot be copied to {address}, and stays: {what}.",
            "Check the address and who may write there.",
        ) from error
