"""Offline detection of a 640 x 576 frame: time, memory, and the error of the recovered rod."""

from __future__ import annotations

import re
import resource
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from benchmarks.scenes import CAMERA, Scene, render, scenes
from bus.errors import CycleFailure
from bus.messages import Detections, Frame, ModelReply, Observation, View
from bus.transforms import apply, inverse
from config.load import load_station
from perception.align.base import Array
from perception.detector import detect
from perception.models import open_models

_DEPTH_NOISE_M = 0.001
_TABLE_RGB, _OBJECT_RGB = (168, 172, 176), (60, 110, 190)
_CENTER_M, _WIDTH_M = 0.006, 0.010
_NUMBER = re.compile(r"-?\d+\.\d+")
SETTINGS = ("scene.pick_region_m=[-0.25, 0.25, -0.25, 0.25]",)


@dataclass(frozen=True)
class Run:
    """One frame: CPU time of its detection, and how it ended."""

    name: str
    ms: float
    outcome: str
    came_back: bool


def run(frames: int, seed: int, tell: Callable[[str], None]) -> dict[str, Any]:
    """``frames`` scenes of the 24 objects, camera tilted by 0 to 30 degrees, 1 mm of depth noise."""
    cv2.setNumThreads(1)
    station = load_station(None, SETTINGS)
    models = open_models(station, {})
    runs: list[Run] = []
    for name, observation in observations(frames, seed):
        replies: list[ModelReply] = []
        began_s = time.process_time()
        try:
            found = detect(observation, station, models, replies.append)
            outcome, back = "found", came_back(found, replies, observation)
        except CycleFailure as failure:
            outcome, back = str(failure.failure), False
        runs.append(Run(name, 1e3 * (time.process_time() - began_s), outcome, back))
        tell(f"{len(runs)}/{frames} {name} {runs[-1].ms:.0f} ms {outcome} {'' if back else 'astray'}")
    return _figures(runs[1:] or runs)


def observations(count: int, seed: int) -> Iterator[tuple[str, Observation]]:
    """Name and observation of ``count`` seeded scenes, object after object; the world is ``base``."""
    for scene, rng in scenes(count, seed):
        yield scene.object.name, _observed(scene, rng)


def came_back(found: Detections, replies: list[ModelReply], observation: Observation) -> bool:
    """Whether a carried run is the axis the model spoke of: middle within 6 mm, width within 10 mm."""
    start, end = np.array([float(number) for number in _NUMBER.findall(replies[-1].text)]).reshape(2, 3)
    width_m = spoken_width_m(replies)
    ends = apply(observation.view.base_from_color, np.array(found.evidence.rod_ends))
    apart_m = float(np.linalg.norm((ends.mean(axis=0) - (start + end) / 2)[:2]))
    return apart_m < _CENTER_M and abs(float(np.linalg.norm(ends[1] - ends[0])) - width_m) < _WIDTH_M


def spoken_width_m(replies: list[ModelReply]) -> float:
    """Return the width [m] between the faces that the model named last; a reply that failed names none."""
    reasons = [reply.text for reply in replies if reply.step == "reason" and reply.failure is None]
    return float(_NUMBER.findall(reasons[-1])[0]) / 1e3


def _observed(scene: Scene, rng: np.random.Generator) -> Observation:
    picture = render(scene, scene.camera_from_object, None)
    base_from_color = inverse(scene.camera_from_world)
    depth_m = np.where(np.isfinite(picture.depth_m), picture.depth_m, _table(base_from_color))
    depth_m = depth_m + _DEPTH_NOISE_M * rng.standard_normal(depth_m.shape)
    color = np.where(picture.object[..., None], np.array(_OBJECT_RGB), np.array(_TABLE_RGB))
    color = np.clip(color + rng.normal(0, 3, color.shape), 0, 255).astype(np.uint8)
    frame = Frame(
        stamp_ns=1,
        color=color,
        depth_m=depth_m.astype(np.float32),
        color_camera=CAMERA,
        depth_camera=CAMERA,
        color_from_depth=np.eye(4),
    )
    return Observation(view=View(stamp_ns=1, base_from_color=base_from_color), frame=frame)


def _table(base_from_color: Array) -> Array:
    """Z-depth of the plane z = 0 of ``base`` in every pixel."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], axis=-1)
    return np.asarray(-base_from_color[2, 3] / (rays @ base_from_color[2, :3]))


def _figures(runs: list[Run]) -> dict[str, Any]:
    """The first frame, which fills caches, is left out."""
    times = np.array([one.ms for one in runs])
    return {
        "frames": len(runs),
        "median_ms": float(np.median(times)),
        "p95_ms": float(np.percentile(times, 95)),
        "rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "closed_loop": float(np.mean([one.came_back for one in runs if one.outcome == "found"])),
        "by_outcome": {
            name: sum(one.outcome == name for one in runs) for name in sorted({one.outcome for one in runs})
        },
        "astray": sorted(one.name for one in runs if one.outcome == "found" and not one.came_back),
    }
