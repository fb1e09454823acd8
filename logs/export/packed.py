"""One episode ready to be written: its pictures encoded, and small enough to travel between processes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from logs.export.clock import Array
from logs.export.episode import Episode, read_episode
from logs.export.features import CAMERAS, Camera
from logs.export.selection import NothingToExport, Work, readable
from logs.export.statistics import Stats, of_numbers, of_picture, pooled
from logs.export.video import KeyFrames


@dataclass(frozen=True)
class PackedVideo:
    """The pictures of one camera.

    Attributes:
        shape: (height, width) [px]. ``runs``: each encoded, with its number of frames.
    """

    shape: tuple[int, int]
    runs: tuple[tuple[bytes, int], ...]
    stats: Stats


@dataclass(frozen=True)
class Packed:
    """One episode. ``columns``, ``about``: as in `logs.export.episode.Episode`. ``videos``: by the camera's key."""

    columns: dict[str, Array]
    about: dict[str, Any]
    videos: dict[str, PackedVideo]

    @property
    def task(self) -> str:
        """The task that was asked for, in words."""
        return str(self.about["task"])

    def numbered(self, episode: int, first: int, task: int, fps: int) -> dict[str, Array]:
        """All columns of its frames. ``episode``, ``task``: its numbers. ``first``: the number of its first frame."""
        index = np.arange(len(self))
        return {
            **self.columns,
            "timestamp": index / fps,
            "frame_index": index,
            "episode_index": np.full(len(self), episode),
            "index": first + index,
            "task_index": np.full(len(self), task),
        }

    def stats(self, columns: dict[str, Array]) -> dict[str, Stats]:
        """Return the statistics of its columns and of its videos."""
        numbers = {key: of_numbers(values) for key, values in columns.items()}
        return {**numbers, **{key: video.stats for key, video in self.videos.items()}}

    def __len__(self) -> int:
        return len(self.columns["utc_ns"])


def packing(root: Path, fps: int) -> Work[Packed]:
    """Return the work that makes a packed episode of a recording. ``root``: the folder of recordings."""
    return partial(readable, partial(_packed, root=root, fps=fps))


def _packed(path: Path, root: Path, fps: int) -> Packed:
    episode = read_episode(path, root, fps)
    return Packed(episode.columns, episode.about, {key: _video(episode, key, one) for key, one in CAMERAS.items()})


def _video(episode: Episode, key: str, camera: Camera) -> PackedVideo:
    """Raises: NothingToExport when the pictures are of several sizes, or of an odd one."""
    pictures = [(camera.encoded(look.frame), look.frame, frames) for look, frames in episode.runs]
    shapes = sorted({picture.shape[:2] for picture, _, _ in pictures})
    if len(shapes) > 1:
        sizes = ", ".join(f"{width} x {height}" for height, width in shapes)
        raise NothingToExport(f"{key} has {sizes} pixels: a video needs one size.")
    if shapes[0][0] % 2 or shapes[0][1] % 2:
        raise NothingToExport(f"{key} has {shapes[0][1]} x {shapes[0][0]} pixels; a video needs even numbers.")
    encoder = KeyFrames(shapes[0], camera.form)
    runs = tuple((encoder.encoded(picture), frames) for picture, _, frames in pictures)
    stats = pooled([of_picture(camera.measured(frame), frames) for _, frame, frames in pictures])
    return PackedVideo(shapes[0], runs, stats)
