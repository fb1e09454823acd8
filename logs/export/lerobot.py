"""Writes recorded cycles as a LeRobot data set of version 3.0, without that package (docs/export.md)."""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from bus.errors import ConfigError
from logs.export.clock import Array
from logs.export.features import CAMERAS, EPISODE, episode_table, frame_table, info, task_table
from logs.export.folder import new_folder
from logs.export.packages import parquet, require
from logs.export.packed import Packed, packing
from logs.export.rolling import Limits, RollingTable, RollingVideo
from logs.export.selection import Done, NothingToExport, Progress, Runner, Selection, alone
from logs.export.statistics import KEYS, Stats, pooled

MAX_FPS = 100


def export_lerobot(
    selection: Selection,
    target: Path,
    progress: Progress,
    *,
    fps: int = 10,
    limits: Limits | None = None,
    run: Runner = alone,
) -> Done:
    """Write the selected recordings as a data set, one episode each.

    Args:
        target: its folder, which must not exist; it appears when it is complete. ``limits``: of its files.
        run: who reads the recordings and encodes their pictures; the data set is the same whoever does.

    Raises: ConfigError without pyarrow or av, for an existing folder, or a rate that is none; RecordingError when no
        recording can be exported, or the folder cannot be written.
    """
    require("pyarrow", "av")
    if not 1 <= fps <= MAX_FPS:
        raise ConfigError(f"{fps} frames a second are none.", f"Name 1 to {MAX_FPS}.")
    read_bytes = 0
    with new_folder(target) as folder, ExitStack() as files:
        dataset = _Dataset(folder, fps, limits or Limits(), files)
        for path, episode in selection.done(packing(selection.root, fps), run, progress):
            try:
                dataset.add(episode)
                read_bytes += path.stat().st_size
            except NothingToExport as error:
                selection.leave_out(path, error)
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
        """The number of each kind of thing in it."""
        return {"episodes": self.episodes, "frames": self.frames, "tasks": len(self.tasks)}

    def add(self, episode: Packed) -> None:
        """Add one episode. Raises: NothingToExport when its pictures are not as large as those before."""
        self._require_one_shape(episode)
        task = self.tasks.setdefault(episode.task, len(self.tasks))
        columns = episode.numbered(self.episodes, self.frames, task, self._fps)
        stats = episode.stats(columns)
        where = self._written(columns)
        for key, video in episode.videos.items():
            place = self._videos[key].add(video.shape, video.runs)
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

    def _require_one_shape(self, episode: Packed) -> None:
        for key, video in episode.videos.items():
            (height, width), (first_height, first_width) = video.shape, self._shapes.get(key, video.shape)
            if (height, width) != (first_height, first_width):
                raise NothingToExport(
                    f"{key} has {width} x {height} pixels, in this data set {first_width} x {first_height}."
                )
        self._shapes |= {key: video.shape for key, video in episode.videos.items()}

    def _written(self, columns: dict[str, Array]) -> dict[str, Any]:
        chunk, file = self._data.next_place()
        self._data.add(frame_table(columns))
        return {"data/chunk_index": chunk, "data/file_index": file}

    def _tell(self, episode: Packed, where: dict[str, Any], stats: dict[str, Stats]) -> None:
        chunk, file = self._told.next_place()
        told = {
            "episode_index": self.episodes,
            "tasks": [episode.task],
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
