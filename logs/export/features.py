"""THE table of features: what an exported frame and an exported episode hold, and how LeRobot is told of it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from bus.messages import Frame
from logs.export.clock import Array
from logs.export.outcome import OUTCOME
from logs.export.packages import column_type, pyarrow
from logs.export.rolling import CHUNK_FILES, Limits
from logs.export.signals import STAGES
from logs.export.video import COLOR, DEPTH, DEPTH_MAX_M, DEPTH_MIN_M, DEPTH_SHIFT_M, GROUP, Format, depth_codes

VERSION = "v3.0"
_JOINTS = tuple(f"fr3_joint{number}" for number in range(1, 8))
_POSE = tuple(f"base_from_color_{row}{column}" for row in range(4) for column in range(4))


class Feature(NamedTuple):
    """One column of a frame. ``names``: of the parts of a vector, none for a single number; ``dtype``: of numpy."""

    dtype: str
    names: tuple[str, ...]
    what: str


FEATURES: dict[str, Feature] = {
    "observation.state": Feature(
        "float32",
        (*_JOINTS, "width_m"),
        "Joints as measured [rad], between two samples linear; distance of the pads, the last one [m].",
    ),
    "action": Feature(
        "float32",
        (*_JOINTS, "width_m"),
        "Commanded joints [rad] and width [m] at the time of the next frame; width 0: close, and keep pressing.",
    ),
    "joint_velocity": Feature("float32", _JOINTS, "Measured [rad/s]."),
    "external_torque": Feature("float32", _JOINTS, "Measured on the joints, without gravity [Nm]."),
    "camera_pose": Feature("float32", _POSE, "Of the colour camera in `base` when the picture was taken [m], by rows."),
    "camera_age_s": Feature("float32", (), "How long ago the picture was taken [s]."),
    "stage_index": Feature("int64", (), "What the cell did: " + ", ".join(f"{n} {s}" for n, s in enumerate(STAGES))),
    "utc_ns": Feature("int64", (), "The frame's time of the wall, UTC [ns]."),
    "arm_utc_ns": Feature("int64", (), "When the joints nearest to it were measured, UTC [ns]."),
    "hand_utc_ns": Feature("int64", (), "When its width, the last one, was measured, UTC [ns]."),
    "camera_utc_ns": Feature("int64", (), "When the picture was taken (middle of the exposure), UTC [ns]."),
    "next.done": Feature("bool", (), "True in the last frame."),
    "next.success": Feature("bool", (), "True in the last frame of a cycle that ended in SUCCESS."),
}
"""The columns of a frame that are ours, in order."""
INDICES: dict[str, Feature] = {
    "timestamp": Feature("float32", (), "frame_index / fps [s]: the grid, not the time of a measurement."),
    "frame_index": Feature("int64", (), "Within the episode, from 0."),
    "episode_index": Feature("int64", (), "Of the episode, from 0."),
    "index": Feature("int64", (), "Within the data set, from 0."),
    "task_index": Feature("int64", (), "Of the task, in `meta/tasks.parquet`."),
}
"""The columns that every LeRobot data set has."""


class Camera(NamedTuple):
    """A video. ``encoded``: the picture as it is encoded. ``measured``: in the units of its statistics."""

    form: Format
    encoded: Callable[[Frame], Array]
    measured: Callable[[Frame], Array]
    what: str


CAMERAS: dict[str, Camera] = {
    "observation.images.color": Camera(
        COLOR,
        lambda frame: frame.color,
        lambda frame: frame.color / 255,
        "RGB as the camera gave it, distorted.",
    ),
    "observation.images.depth": Camera(
        DEPTH,
        lambda frame: depth_codes(frame.depth_m),
        lambda frame: np.nan_to_num(frame.depth_m * 1000, nan=0.0),
        "z-depth in the depth camera, not registered to colour: 12 bits, logarithmic; 0 = not measured.",
    ),
}

EPISODE = {key: row for key, row in OUTCOME.items() if key != "task"}
"""The columns of an episode that are ours: type and meaning. The task has columns of its own."""


def frame_table(columns: Mapping[str, Array]) -> Any:
    """Return the rows of an episode's frames: vectors as lists of a fixed length."""
    arrays = {}
    for key, feature in {**FEATURES, **INDICES}.items():
        values = columns[key].astype(feature.dtype)
        flat = pyarrow.array(values.ravel())
        arrays[key] = pyarrow.FixedSizeListArray.from_arrays(flat, len(feature.names)) if feature.names else flat
    return pyarrow.table(arrays)


def episode_table(told: Mapping[str, Any]) -> Any:
    """Return the row of one episode."""
    return pyarrow.table({key: pyarrow.array([value], _type_of(key)) for key, value in told.items()})


def _type_of(key: str) -> Any:
    if key in EPISODE:
        return column_type(EPISODE[key][0])
    if key == "tasks":
        return column_type("list<string>")
    if key.startswith("stats/"):
        whole = key.endswith("/count")
        is_picture = key.split("/")[1] in CAMERAS and not whole
        return column_type("list<int64>" if whole else "list<list<list<double>>>" if is_picture else "list<double>")
    return column_type("double" if key.endswith("_timestamp") else "int64")


def task_table(tasks: Sequence[str]) -> Any:
    """Return the tasks, as pandas writes them: the text is the index of the table."""
    table = pyarrow.table({"task_index": pyarrow.array(range(len(tasks)), pyarrow.int64()), "task": list(tasks)})
    named = {"name": "task_index", "field_name": "task_index", "pandas_type": "int64", "numpy_type": "int64"}
    index = {"name": "task", "field_name": "task", "pandas_type": "unicode", "numpy_type": "object"}
    said = {"index_columns": ["task"], "column_indexes": [], "pandas_version": "2.0.0"}
    columns = [{**one, "metadata": None} for one in (named, index)]
    return table.replace_schema_metadata({"pandas": json.dumps({**said, "columns": columns})})


def info(counts: Mapping[str, int], fps: int, shapes: Mapping[str, tuple[int, int]], limits: Limits) -> dict[str, Any]:
    """Return the content of ``meta/info.json``. ``shapes``: (height, width) of each camera's pictures."""
    videos = {key: _video(key, fps, shapes[key]) for key in CAMERAS}
    numbers = {
        key: {"dtype": one.dtype, "shape": [len(one.names) or 1], "names": list(one.names) or None}
        for key, one in {**FEATURES, **INDICES}.items()
    }
    return {
        "codebase_version": VERSION,
        "robot_type": "fr3",
        "total_episodes": counts["episodes"],
        "total_frames": counts["frames"],
        "total_tasks": counts["tasks"],
        "chunks_size": CHUNK_FILES,
        "data_files_size_in_mb": max(limits.data_bytes // 1_000_000, 1),
        "video_files_size_in_mb": max(limits.video_bytes // 1_000_000, 1),
        "fps": fps,
        "splits": {"train": f"0:{counts['episodes']}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
        "features": {**videos, **numbers},
    }


def _video(key: str, fps: int, shape: tuple[int, int]) -> dict[str, Any]:
    form, (height, width) = CAMERAS[key].form, shape
    facts: dict[str, Any] = {
        "video.height": height,
        "video.width": width,
        "video.codec": form.codec,
        "video.pix_fmt": form.pix_fmt,
        "video.fps": fps,
        "video.channels": form.channels,
        "video.is_depth_map": form is DEPTH,
        "video.g": GROUP,
        "has_audio": False,
    }
    if form is DEPTH:
        facts |= {"is_depth_map": True, "video.depth_min": DEPTH_MIN_M, "video.depth_max": DEPTH_MAX_M}
        facts |= {"video.shift": DEPTH_SHIFT_M, "video.use_log": True}
    names = ["height", "width", "channels"]
    return {"dtype": "video", "shape": [height, width, form.channels], "names": names, "info": facts}
