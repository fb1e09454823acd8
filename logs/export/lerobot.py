"""Writes recorded cycles as a LeRobot data set of version 3.0, without that package (docs/export.md)."""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from bus.errors import ConfigError
from logs.export.clock import Array
from logs.export.episode import Episode, read_episode
from logs.export.features import CAMERAS, EPISODE, episode_table, frame_table, info, task_table
from logs.export.folder import new_folder
from logs.export.packages import parquet, require
from logs.export.rolling import Limits, RollingTable, RollingVideo
from logs.export.selection import Done, NothingToExport, Progress, Selection
from logs.export.statistics import KEYS, Stats, of_numbers, of_picture, pooled

MAX_FPS = 100


def export_lerobot(
    selection: Selection, target: Path, progress: Progress, *, fps: int = 10, limits: Limits | None = None
) -> Done:
    """Write the selected recordings as a data set, one episode each.

    Args:
        target: its folder, which must not exist; it appears when it is complete. ``limits``: of its files.

    Raises: ConfigError without pyarrow or av, for an existing folder, or a rate that is none; RecordingError when no
        recording can be exported, or the folder cannot be written.
    """
    require("pyarrow", "av")
    if not 1 <= fps <= MAX_FPS:
        raise ConfigError(f"{fps} frames a second are none.", f"Name 1 to {MAX_FPS}.")
    read_bytes = 0
    with new_folder(target) as folder, ExitStack() as files:
        dataset = _Dataset(folder, fps, limits or Limits(), files)
        for path in progress(selection.paths, len(selection.paths)):
            with selection.or_left_out(path):
                dataset.add(read_episode(path, selection.root, fps))
                read_bytes += path.stat().st_size
        if not dataset.episodes:
            raise selection.nothing()
        files.close()
        dataset.finish()
    return Done(target, dataset.counts, read_bytes, tuple(selection.left_out))


class _Dataset:
    """A data set that is being written; its files are closed when ``files`` is.

    Attributes:
        episodes, frames: how many it has. ``tasks``: the index of each text.
    """

    def __init__(self, folder: Path, fps: int, limits: Limits, files: ExitStack) -> None:
        self.episodes = self.frames = 0
        self.tasks: dict[str, int] = {}
        self._folder, self._fps, self._limits = folder, fps, limits
        self._shapes: dict[str, tuple[int, int]] = {}
        self._all: dict[str, Stats] = {}
        self._data = RollingTable(folder / "data", limits.data_bytes)
        self._told = RollingTable(folder / "meta" / "episodes", limits.data_bytes)
        self._videos = {
            key: RollingVideo(folder / "videos" / key, fps, camera.form, limits) for key, camera in CAMERAS.items()
        }
        for close in (self._data.close, self._told.close, *(video.close for video in self._videos.values())):
            files.callback(close)

    @property
    def counts(self) -> dict[str, int]:
        """How much it has of what."""
        return {"episodes": self.episodes, "frames": self.frames, "tasks": len(self.tasks)}

    def add(self, episode: Episode) -> None:
        """Add one episode. Raises: NothingToExport when its pictures are not as large as those before."""
        self._require_one_shape(episode)
        columns = self._columns(episode)
        stats = {key: of_numbers(values) for key, values in columns.items()}
        where = self._written(columns)
        for key, camera in CAMERAS.items():
            seen = [(look.frame, times) for look, times in episode.runs]
            stats[key] = pooled([of_picture(camera.measured(frame), times) for frame, times in seen])
            place = self._videos[key].add([(camera.encoded(frame), times) for frame, times in seen])
            where |= {f"videos/{key}/{name}": value for name, value in place.items()}
        self._tell(episode, where, stats)
        self._all = {key: pooled([self._all[key], found]) if self._all else found for key, found in stats.items()}
        self.episodes += 1
        self.frames += len(episode)

    def finish(self) -> None:
        """Write what is said of all episodes."""
        meta = self._folder / "meta"
        facts = info(self.counts, self._fps, self._shapes, self._limits)
        (meta / "info.json").write_text(json.dumps(facts, indent=4))
        stats = {key: {name: value.tolist() for name, value in found.items()} for key, found in self._all.items()}
        (meta / "stats.json").write_text(json.dumps(stats, indent=4))
        parquet.write_table(task_table(list(self.tasks)), meta / "tasks.parquet")

    def _require_one_shape(self, episode: Episode) -> None:
        for key, camera in CAMERAS.items():
            found = {camera.encoded(look.frame).shape[:2] for look, _ in episode.runs}
            expected = self._shapes.get(key, next(iter(found)))
            if found != {expected}:
                sizes = ", ".join(f"{width} x {height}" for height, width in sorted(found))
                raise NothingToExport(f"{key} has {sizes} pixels, in this data set {expected[1]} x {expected[0]}.")
            if expected[0] % 2 or expected[1] % 2:
                raise NothingToExport(f"{key} has {expected[1]} x {expected[0]} pixels; a video needs even numbers.")
        self._shapes |= {key: camera.encoded(episode.pictures[0].frame).shape[:2] for key, camera in CAMERAS.items()}

    def _columns(self, episode: Episode) -> dict[str, Array]:
        index = np.arange(len(episode))
        task = self.tasks.setdefault(episode.about["task"], len(self.tasks))
        return {
            **episode.columns,
            "timestamp": index / self._fps,
            "frame_index": index,
            "episode_index": np.full(len(episode), self.episodes),
            "index": self.frames + index,
            "task_index": np.full(len(episode), task),
        }

    def _written(self, columns: dict[str, Array]) -> dict[str, Any]:
        chunk, file = self._data.next_place()
        self._data.add(frame_table(columns))
        return {"data/chunk_index": chunk, "data/file_index": file}

    def _tell(self, episode: Episode, where: dict[str, Any], stats: dict[str, Stats]) -> None:
        chunk, file = self._told.next_place()
        told = {
            "episode_index": self.episodes,
            "tasks": [episode.about["task"]],
            "length": len(episode),
            "dataset_from_index": self.frames,
            "dataset_to_index": self.frames + len(episode),
            **where,
            "meta/episodes/chunk_index": chunk,
            "meta/episodes/file_index": file,
            **{key: episode.about[key] for key in EPISODE},
            **{f"stats/{key}/{name}": found[name].tolist() for key, found in stats.items() for name in KEYS},
        }
        self._told.add(episode_table(told))
