"""Writes one cycle into one MCAP file; a killed process loses nothing that was flushed.

The file is ``<path>.part`` until it is closed. Chunks are compressed and closed at every flush: a sequential reader of
an unfinished file finds every message up to the last flush.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import stat
import threading
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Protocol, cast

from bus.atomic import sync_folder
from bus.codec import schema_of
from bus.errors import RecordingError
from logs.mcap.writer import McapFile

PART = ".part"
MODE = 0o640
"""File mode of recordings and of their report pages."""
_BLOCK_BYTES = 1 << 20
_MESSAGE_ENCODING = {"jsonschema": "json", "protobuf": "protobuf"}


def open_part(path: Path) -> BinaryIO:
    """Open a new recording for writing. It is locked while it is written, so that recovery does not take it for torn.

    Raises: OSError, BlockingIOError when another process writes it.
    """
    file = os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT, MODE), "wb")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            file.truncate()  # only now: before the lock, another process may be writing it
            os.fchmod(file.fileno(), MODE)  # independent of the umask
    except OSError:
        file.close()
        raise
    return file


def ensure_space(folder: Path, min_free_mb: float) -> None:
    """Create ``folder``, and check the right to write there and the free space [MB] of its disk.

    Raises: RecordingError when the folder cannot be created or written, or too little is free.
    """
    with _as_recording_error(folder):
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise RecordingError(
                f"Nothing can be written to {folder.absolute()}.",
                "Give yourself the right to write there, or set recording.folder.",
            )
        free_mb = shutil.disk_usage(folder).free / 1e6
    if free_mb < min_free_mb:
        raise RecordingError(
            f"Only {free_mb:.0f} MB are free in {folder}; recording needs {min_free_mb:.0f} MB.",
            "Delete or move old recordings; set recording.keep_gb (then the oldest are deleted) or recording.folder.",
        )


class Output(Protocol):
    """The file interface that a recording is written to."""

    def write(self, data: bytes, /) -> int: ...
    def flush(self) -> None: ...
    def fileno(self) -> int: ...
    def close(self) -> None: ...

    @property
    def closed(self) -> bool: ...


Under = Callable[[BinaryIO], Output]


def plain(file: BinaryIO) -> Output:
    """Return the file unchanged."""
    return file


class Recorder:
    """One recording. Thread-safe; every method raises RecordingError when the disk fails.

    Args:
        path: the final ``.mcap``; its folders are created.
        metadata: the information needed to rerun the cycle; written first.
        clock: UTC [ns].
        under: maps the opened file to the one to write to, e.g. to inject faults.
    """

    def __init__(
        self,
        path: Path,
        *,
        metadata: Mapping[str, str],
        clock: Callable[[], int],
        under: Under = plain,
    ) -> None:
        self.path = path
        self._clock = clock
        self._lock = threading.Lock()
        self._channels: dict[tuple[str, str], int] = {}
        self._schemas: dict[str, int] = {}
        self._sequence: dict[int, int] = {}
        with _as_recording_error(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = under(open_part(self._part))
            try:
                self._writer = McapFile(cast(BinaryIO, self._file))
                self._writer.metadata("run", metadata)
            except OSError:
                self.abandon()
                raise

    @property
    def _part(self) -> Path:
        return self.path.with_name(self.path.name + PART)

    def write(self, key: str, encoding: str, payload: bytes, *, log_time_ns: int) -> None:
        """Append one payload of topic ``key`` with a Zenoh ``encoding`` of the topic table; ``log_time_ns``: UTC."""
        with self._lock, _as_recording_error(self.path):
            channel = self._channel(key, encoding)
            self._sequence[channel] = sequence = self._sequence.get(channel, 0) + 1
            self._writer.message(channel, log_time_ns, payload, log_time_ns, sequence)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Store a whole file as an attachment."""
        now_ns = self._clock()
        with self._lock, _as_recording_error(self.path):
            self._writer.attachment(now_ns, name, media_type, data)

    def flush(self) -> None:
        """Close the chunk and pass all data to the operating system."""
        with self._lock, _as_recording_error(self.path):
            self._writer.flush()

    def close(self, result: Mapping[str, str]) -> Path:
        """Write ``result``, the index and the footer, sync, read the file back, and give it its final name. Idempotent.

        Raises: RecordingError, also when the file does not contain what was written.
        """
        with self._lock, _as_recording_error(self.path):
            if not self._file.closed:
                self._writer.metadata("result", result)
                self._writer.finish()
                self._file.flush()
                os.fsync(self._file.fileno())
                self._file.close()
                self._require_readable()
                self._part.rename(self.path)
                sync_folder(self.path.parent)
        return self.path

    def _require_readable(self) -> None:
        """Read the synced file back from the disk and compare its checksum; its page cache is dropped first.

        A file system in memory, or one that ignores the advice, still reads from the cache.

        Raises: RecordingError.
        """
        read = 0
        with self._part.open("rb") as file:
            os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
            while block := file.read(_BLOCK_BYTES):
                read = zlib.crc32(block, read)
        if read != self._writer.crc:
            raise RecordingError(f"{self._part} does not hold what was written.", "Check the disk.")

    def abandon(self) -> None:
        """Close the file as it is after the disk failed; the ``.part`` remains. Never raises; idempotent."""
        with self._lock, suppress(OSError):  # closing flushes, which fails again
            self._file.close()

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close({} if error is None else {"error": str(error)})

    def _channel(self, key: str, encoding: str) -> int:
        known = self._channels.get((key, encoding))
        if known is not None:
            return known
        schema = schema_of(encoding)
        if schema.name not in self._schemas:
            self._schemas[schema.name] = self._writer.schema(schema.name, schema.encoding, schema.data)
        message_encoding = _MESSAGE_ENCODING[schema.encoding]
        channel = self._writer.channel(f"/{key}", message_encoding, self._schemas[schema.name])
        self._channels[key, encoding] = channel
        return channel


@contextmanager
def _as_recording_error(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise RecordingError(
            f"Cannot record into {path}: {error.strerror or error}.",
            "Check the disk's space and rights, or set recording.folder.",
        ) from error
