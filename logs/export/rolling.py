"""The files of a LeRobot data set that hold many episodes, and are followed by another when they are full."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from logs.export.packages import parquet
from logs.export.video import Format, Video

CHUNK_FILES = 1000
"""Files a folder ``chunk-NNN``."""
MAX_VIDEO_S = 900.0
"""LeRobot compares times as float32, to 1e-4 s; beyond 1024 s, two neighbours are 1.2e-4 s apart."""


@dataclass(frozen=True)
class Limits:
    """Sizes at which the next episode begins a new file."""

    data_bytes: int = 100_000_000
    video_bytes: int = 200_000_000
    video_s: float = MAX_VIDEO_S


def place_of(number: int) -> tuple[int, int]:
    """Chunk and file of the n-th file, from 0."""
    return divmod(number, CHUNK_FILES)


def path_of(folder: Path, number: int, suffix: str) -> Path:
    """``folder/chunk-000/file-000.suffix`` of the n-th file, from 0."""
    chunk, file = place_of(number)
    return folder / f"chunk-{chunk:03d}" / f"file-{file:03d}.{suffix}"


class RollingTable:
    """Parquet files below ``folder``, one row group an episode. All tables have one schema."""

    def __init__(self, folder: Path, max_bytes: int) -> None:
        self._folder, self._max_bytes, self._number = folder, max_bytes, -1
        self._file: Any = None
        self._writer: Any = None

    def next_place(self) -> tuple[int, int]:
        """Chunk and file of the next episode."""
        if self._writer is not None and self._file.tell() >= self._max_bytes:
            self.close()
        return place_of(self._number if self._writer is not None else self._number + 1)

    def add(self, table: Any) -> None:
        """Add one episode, at its `next_place`."""
        self.next_place()
        if self._writer is None:
            self._number += 1
            path = path_of(self._folder, self._number, "parquet")
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("wb")
            self._writer = parquet.ParquetWriter(self._file, table.schema, compression="zstd")
        self._writer.write_table(table)

    def close(self) -> None:
        """Finish the file."""
        if self._writer is not None:
            self._writer.close()
            self._file.close()
            self._writer = None


class RollingVideo:
    """MP4 files of one camera below ``folder``."""

    def __init__(self, folder: Path, fps: int, form: Format, limits: Limits) -> None:
        self._folder, self._fps, self._form, self._limits, self._number = folder, fps, form, limits, -1
        self._video: Video | None = None

    def add(self, shape: tuple[int, int], runs: Sequence[tuple[bytes, int]]) -> dict[str, Any]:
        """Add the pictures of one episode, encoded, each with its number of frames; return where they are."""
        video = self._with_room(shape)
        first = video.frames
        for key, frames in runs:
            video.hold(key, frames)
        chunk, file = place_of(self._number)
        return {
            "chunk_index": chunk,
            "file_index": file,
            "from_timestamp": first / self._fps,
            "to_timestamp": video.frames / self._fps,
        }

    def close(self) -> None:
        """Finish the file."""
        if self._video is not None:
            self._video.close()
            self._video = None

    def _with_room(self, shape: tuple[int, int]) -> Video:
        video = self._video
        if video is not None:
            is_full = video.size_bytes >= self._limits.video_bytes or video.frames >= self._limits.video_s * self._fps
            if not is_full:
                return video
        self.close()
        self._number += 1
        self._video = Video(path_of(self._folder, self._number, "mp4"), self._fps, shape, self._form)
        return self._video
