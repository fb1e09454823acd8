"""The outcome of a cycle and of its grasp, as columns of a data set."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from bus.arrays import Transform
from bus.messages import CameraModel, Frame, Grasp, Job
from logs.mcap.reader import CycleRecord

_REAL, _TEXT = "double", "string"
OUTCOME: dict[str, tuple[str, str]] = {
    "cycle_id": (_TEXT, "UTC time at which it was asked for, to the millisecond."),
    "recording": (_TEXT, "Path of the recording, below the folder of recordings."),
    "result": (_TEXT, "SUCCESS, FAILED, ABORTED or EMPTY; UNFINISHED without one."),
    "code": (_TEXT, "Why not SUCCESS: one of `bus/codes.py`; else empty."),
    "reason": (_TEXT, "The same in words."),
    "task": (_TEXT, "What was asked for, in words."),
    "object": (_TEXT, "Name of the simulated object; empty on hardware."),
    "job_id": (_TEXT, "The client's own name of the job."),
    "executed": ("bool", "The fingers closed."),
    "held": ("bool", "What verify decided; null: it did not come so far."),
    "base_from_tcp": (
        f"list<{_REAL}>",
        "The grasp as planned, with its tilt (4 x 4, by rows), in `base` [m].",
    ),
    "score": (_REAL, "Of that grasp; null, as above: none was planned."),
    "grasped_width_m": (_REAL, "Distance of the pads when they had closed; null: they never did."),
    "load_n": (_REAL, "Vertical force of what was held; null: not measured."),
    "color_camera": (_TEXT, "Intrinsics of the colour camera (`bus.messages.CameraModel` as JSON)."),
    "depth_camera": (_TEXT, "Intrinsics of the depth camera."),
    "color_from_depth": (f"list<{_REAL}>", "Pose of the depth camera in the colour camera (4 x 4, by rows) [m]."),
    "station_hash": (_TEXT, "Of the whole station."),
}
"""The columns of a cycle: type and meaning."""


def outcome(record: CycleRecord, recording: str, frame: Frame) -> dict[str, Any]:
    """Return the values of `OUTCOME`. ``recording``: its path. ``frame``: one that its cameras took."""
    execution, verdict, result = _result(record, "execute"), _result(record, "verify"), record.result
    grasp, pose = planned_grasp(record)
    grasped = execution.grasped if execution is not None else None
    return {
        "cycle_id": record.cycle_id,
        "recording": recording,
        "result": record.metadata.get("result", "UNFINISHED"),
        "code": record.metadata.get("code", ""),
        "reason": record.metadata.get("reason", ""),
        "task": task_of(record.attempt.job),
        "object": result.object if result is not None else "",
        "job_id": record.attempt.job.job_id,
        "executed": grasped is not None,
        "held": verdict.held if verdict is not None else None,
        "base_from_tcp": pose.ravel().tolist() if pose is not None else None,
        "score": grasp.score if grasp is not None else None,
        "grasped_width_m": grasped.width_m if grasped is not None else None,
        "load_n": verdict.load_n if verdict is not None else None,
        "color_camera": as_json(frame.color_camera),
        "depth_camera": as_json(frame.depth_camera),
        "color_from_depth": frame.color_from_depth.ravel().tolist(),
        "station_hash": record.metadata.get("station_hash", ""),
    }


def planned_grasp(record: CycleRecord) -> tuple[Grasp | None, Transform | None]:
    """Return the grasp that plan chose, and ``base_from_tcp`` (4, 4) with the tilt it chose; None without a plan."""
    found, plan = _result(record, "detect"), _result(record, "plan")
    if found is None or plan is None:
        return None, None
    grasp: Grasp = found.grasps[plan.grasp]
    c, s = np.cos(plan.tilt_rad), np.sin(plan.tilt_rad)
    tilt = np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1]])  # about the closing axis, tcp y
    return grasp, np.asarray(grasp.base_from_tcp @ tilt)


def task_of(job: Job) -> str:
    """Return what was asked for, as an instruction."""
    target = job.target
    what = target.text if target is not None and target.text is not None else "the object"
    where = f", lay it at {job.place.name}" if job.place is not None and job.place.name is not None else ""
    return f"pick {what}{where}"


def as_json(camera: CameraModel) -> str:
    """Return the intrinsics of a camera as JSON."""
    return json.dumps(camera.model_dump(mode="json"))


def _result(record: CycleRecord, stage: str) -> Any:
    return record.stages[stage].result if stage in record.stages else None
