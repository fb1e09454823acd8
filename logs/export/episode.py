"""One recorded cycle as an episode: every signal at a fixed rate, and the pictures that were seen then."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bus.errors import BadPayload, RecordingError
from bus.messages import Observation
from logs.export.clock import Array, EpisodeClock, Played, played
from logs.export.outcome import outcome
from logs.export.selection import NothingToExport
from logs.export.signals import (
    Samples,
    commanded_joints,
    commanded_width,
    measured_joints,
    measured_width,
    stage_index,
)
from logs.mcap.migrate import Content
from logs.mcap.names import shown, telling
from logs.mcap.reader import CycleRecord, read_with_messages

MAX_FRAMES = 200_000


@dataclass(frozen=True)
class Episode:
    """One cycle, frame by frame.

    Attributes:
        columns: of each feature its values, (n, d) or (n,), one row a frame.
        pictures: the looks, in order; ``shown``: (n,) which of them is the last one at each frame.
        about: the `logs.export.outcome.OUTCOME` of the cycle.
    """

    columns: dict[str, Array]
    pictures: tuple[Observation, ...]
    shown: Array
    about: dict[str, Any]

    def __len__(self) -> int:
        return len(self.shown)

    @property
    def runs(self) -> Iterator[tuple[Observation, int]]:
        """Each picture with the number of frames that show it, in order."""
        for index, times in zip(*np.unique(self.shown, return_counts=True), strict=True):
            yield self.pictures[index], int(times)


def read_episode(path: Path, root: Path, fps: int) -> Episode:
    """Read a recording from its first look to its end, ``fps`` frames a second. ``root``: the folder of recordings.

    Raises: NothingToExport when it lacks pictures, joints or widths; RecordingError when it cannot be read.
    """
    record, content = read_with_messages(path)
    try:
        with telling(shown(path)):
            return _episode(os.path.relpath(path, root), record, content, fps)
    except BadPayload as error:
        raise RecordingError(f"{shown(path)} holds a damaged message: {error.text}") from error


def _episode(recording: str, record: CycleRecord, content: Content, fps: int) -> Episode:
    pictures = tuple(sorted(_seen(record), key=lambda look: look.view.stamp_ns))
    if record.station.get("robot") is not None:
        raise NothingToExport("Its arm is not the FR3, whose seven joints the data set has.")
    if not pictures:
        raise NothingToExport("It has no picture.")
    start_ns = pictures[0].view.stamp_ns
    motions = [one for one in played(content) if one.began_ns >= start_ns]
    clock = EpisodeClock(start_ns, motions)
    joints = measured_joints(record, motions, clock)
    at_s = _grid(float(joints.time_s[-1]), fps)
    seen_s = clock.time_s([look.view.stamp_ns for look in pictures])
    shown_at = np.maximum(np.searchsorted(seen_s, at_s + 1e-9, side="right") - 1, 0)
    columns = {
        **_moved(joints, motions, clock, at_s, fps),
        **_gripped(record, content, clock, at_s, fps),
        **_shown(pictures, at_s, seen_s, shown_at),
        **_happened(record, clock, at_s),
    }
    columns["observation.state"] = np.hstack([columns.pop("q_rad"), columns.pop("width_m")])
    columns["action"] = np.hstack([columns.pop("told_q_rad"), columns.pop("told_width_m")])
    for key, values in columns.items():
        if not np.isfinite(values).all():
            raise NothingToExport(f"{key} holds what is no number.")
    return Episode(columns, pictures, shown_at, outcome(record, recording, pictures[0].frame))


def _grid(lasts_s: float, fps: int) -> Array:
    """The times (n,) of the frames."""
    if not lasts_s * fps < MAX_FRAMES:
        raise NothingToExport(f"It lasts {lasts_s:.0f} s, more than {MAX_FRAMES} frames.")
    return np.arange(int(max(lasts_s, 0.0) * fps) + 1) / fps


def _moved(joints: Samples, motions: Sequence[Played], clock: EpisodeClock, at_s: Array, fps: int) -> dict[str, Array]:
    q_rad, velocity, torque = np.split(joints.between(at_s), 3, axis=1)
    return {
        "q_rad": q_rad,
        "told_q_rad": commanded_joints(motions, clock, q_rad[0]).latest(at_s + 1 / fps),
        "joint_velocity": velocity,
        "external_torque": torque,
        "arm_utc_ns": joints.nearest_utc_ns(at_s),
    }


def _gripped(record: CycleRecord, content: Content, clock: EpisodeClock, at_s: Array, fps: int) -> dict[str, Array]:
    samples = measured_width(record, content, clock)
    width_m = samples.latest(at_s)
    return {
        "width_m": width_m,
        "told_width_m": commanded_width(content, clock, width_m[0]).latest(at_s + 1 / fps),
        "hand_utc_ns": samples.latest_utc_ns(at_s),
    }


def _shown(pictures: Sequence[Observation], at_s: Array, seen_s: Array, shown_at: Array) -> dict[str, Array]:
    return {
        "camera_pose": np.array([look.view.base_from_color.ravel() for look in pictures])[shown_at],
        "camera_age_s": at_s - seen_s[shown_at],
        "camera_utc_ns": np.array([look.view.stamp_ns for look in pictures], np.int64)[shown_at],
    }


def _happened(record: CycleRecord, clock: EpisodeClock, at_s: Array) -> dict[str, Array]:
    is_last = np.arange(len(at_s)) == len(at_s) - 1
    is_success = record.result is not None and record.result.result == "SUCCESS"
    return {
        "stage_index": stage_index((*record.superseded, *record.stages.values()), clock, at_s),
        "utc_ns": clock.utc_ns(at_s),
        "next.done": is_last,
        "next.success": is_last & is_success,
    }


def _seen(record: CycleRecord) -> Sequence[Observation]:
    return (*record.looks, *([record.after] if record.after is not None else []))
