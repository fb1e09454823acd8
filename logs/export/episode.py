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
from logs.export.clock import Array, EpisodeClock, played
from logs.export.outcome import outcome
from logs.export.selection import NothingToExport
from logs.export.signals import (
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
    if not pictures:
        raise NothingToExport("It has no picture.")
    stamps = np.array([look.view.stamp_ns for look in pictures], np.int64)
    motions = [one for one in played(content) if one.began_ns >= stamps[0]]
    clock = EpisodeClock(int(stamps[0]), motions)
    joints = measured_joints(record, motions, clock)
    at_s = np.arange(int(max(joints.time_s[-1], 0.0) * fps) + 1) / fps
    if len(at_s) > MAX_FRAMES:
        raise NothingToExport(f"It lasts {at_s[-1]:.0f} s.")
    width = measured_width(record, content, clock)
    next_s = at_s + 1 / fps
    rest = joints.between(at_s[:1])[0]
    told = commanded_joints(motions, clock, rest[:7]).latest(next_s)
    told_width = commanded_width(content, clock, width.latest(at_s[:1])[0]).latest(next_s)
    state, seen_s = joints.between(at_s), clock.time_s(stamps)
    shown_at = np.maximum(np.searchsorted(seen_s, at_s + 1e-9, side="right") - 1, 0)
    poses = np.array([look.view.base_from_color.ravel() for look in pictures])
    is_last = np.arange(len(at_s)) == len(at_s) - 1
    is_success = record.result is not None and record.result.result == "SUCCESS"
    columns = {
        "observation.state": np.hstack([state[:, :7], width.latest(at_s)]),
        "action": np.hstack([told, told_width]),
        "joint_velocity": state[:, 7:14],
        "external_torque": state[:, 14:],
        "camera_pose": poses[shown_at],
        "camera_age_s": at_s - seen_s[shown_at],
        "stage_index": stage_index((*record.superseded, *record.stages.values()), clock, at_s),
        "utc_ns": clock.utc_ns(at_s),
        "arm_utc_ns": joints.nearest_utc_ns(at_s),
        "hand_utc_ns": width.latest_utc_ns(at_s),
        "camera_utc_ns": stamps[shown_at],
        "next.done": is_last,
        "next.success": is_last & is_success,
    }
    return Episode(columns, pictures, shown_at, outcome(record, recording, pictures[0].frame))


def _seen(record: CycleRecord) -> Sequence[Observation]:
    return (*record.looks, *([record.after] if record.after is not None else []))
