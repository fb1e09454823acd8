"""Detection on real RGB-D frames: how many grasps are found, why the others are not, and a picture to judge them by."""

from __future__ import annotations

import itertools
import textwrap
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from benchmarks.datasets.rgbd import RealFrame, read_rgbd
from benchmarks.jaw_picture import draw_jaw
from benchmarks.sheet import write_sheet
from bus.errors import CycleFailure
from bus.messages import Detections, Grasp, Observation
from bus.transforms import apply, inverse
from config.load import load_station
from config.schema import Station
from perception.detector import detect, ignore_reply
from perception.geometry.lift import project
from perception.models import open_models

_COLUMNS = 2
_WHOLE_PX = (680, 510)
"""(width, height) of a frame in the picture."""
_NEAR_M = 0.24
"""Side of the close-up around the grasp."""
_CAPTION_PX, _LINE_PX, _LINE_CHARACTERS = 66, 20, 130
_IN_FRONT_M, _FAR_PX = 0.05, 30_000
_OTHER_CAMERA = "camera.least_range_m=0"
"""The frames are of several cameras, whose least range is not told."""
_OBJECT, _REGION, _TEXT = (255, 220, 0), (90, 160, 255), (255, 255, 255)

Image = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Outcome:
    """One frame: its detections, or the code and text of the refusal; and the CPU time [s] of `detect`."""

    frame: RealFrame
    station: Station
    detections: Detections | None
    code: str
    text: str
    cpu_s: float


def run(root: Path, overrides: list[str], tell: Callable[[str], None], sheet: Path | None = None) -> dict[str, Any]:
    """Detect on every frame in ``root``; ``sheet``: where a picture of all of them goes. Raises: ConfigError."""
    outcomes, tiles = [], []
    for frame in read_rgbd(root):
        outcome = _outcome(frame, overrides)
        outcomes.append(outcome)
        tell(f"{frame.name} {outcome.cpu_s:.2f} s {outcome.code} {outcome.text}")
        if sheet is not None:
            tiles.append(_tile(outcome)[..., ::-1])
    if sheet is not None:
        write_sheet(sheet, tiles, _COLUMNS)
    found = sum(outcome.detections is not None for outcome in outcomes)
    return {
        "frames": len(outcomes),
        "found": found,
        "by_code": Counter(outcome.code for outcome in outcomes if outcome.detections is None),
        "cpu_s_max": max(outcome.cpu_s for outcome in outcomes),
    }


def _outcome(frame: RealFrame, overrides: list[str]) -> Outcome:
    station = load_station(None, [f"scene.pick_region_m={list(frame.region_m)}", _OTHER_CAMERA, *overrides])
    models = open_models(station, {})
    began_s = time.process_time()
    try:
        detections = detect(frame.observation, station, models, ignore_reply)
    except CycleFailure as failure:
        return Outcome(frame, station, None, str(failure.failure), failure.text, time.process_time() - began_s)
    took_s, best = time.process_time() - began_s, detections.grasps[0]
    x_m, y_m, z_m = best.base_from_tcp[:3, 3]
    text = (
        f"score {best.score:.2f}, {best.width_m * 1e3:.0f} mm wide, tcp at ({x_m:.3f}, {y_m:.3f}, {z_m:.3f}) m; "
        f"{len(detections.grasps)} grasps"
    )
    return Outcome(frame, station, detections, "found", text, took_s)


def _tile(outcome: Outcome) -> Image:
    """The outcome in words above the whole frame, and a close-up of the grasp, or of the pick region, beside it."""
    frame, camera = outcome.frame.observation.frame, outcome.frame.observation.frame.color_camera
    region_px = _region_px(outcome)
    image = _dotted(np.array(frame.color[..., :3]), region_px)
    close_up = _fitted(_cut(frame.color[..., :3], region_px), (_WHOLE_PX[1], _WHOLE_PX[1]))
    if outcome.detections is not None:
        best, mask = outcome.detections.grasps[0], outcome.detections.evidence.object_mask
        close_up = _close_up(frame.color[..., :3], mask, best, outcome)
        image = draw_jaw(_outlined(image, mask, 1), best, _color_from_base(outcome), camera, outcome.station.hand)
    pictures = np.hstack([_fitted(image, _WHOLE_PX), close_up])
    return np.vstack([_caption(outcome, pictures.shape[1]), pictures])


def _close_up(color: Image, mask: npt.NDArray[np.bool_], grasp: Grasp, outcome: Outcome) -> Image:
    """A square of `_NEAR_M` around the grasp, enlarged before anything is drawn on it."""
    observation: Observation = outcome.frame.observation
    camera, color_from_base = observation.frame.color_camera, _color_from_base(outcome)
    middle = apply(color_from_base, grasp.base_from_tcp[:3, 3][None])
    (u, v), side_px = project(middle, camera)[0], _NEAR_M * camera.fx / float(middle[0, 2])
    enlarged = _WHOLE_PX[1] / side_px
    left, top = u - side_px / 2, v - side_px / 2
    matrix = np.array([[enlarged, 0, -left * enlarged], [0, enlarged, -top * enlarged]])
    size = (_WHOLE_PX[1], _WHOLE_PX[1])
    part = np.asarray(cv2.warpAffine(np.ascontiguousarray(color), matrix, size), dtype=np.uint8)
    part_mask = cv2.warpAffine(mask.astype(np.uint8), matrix, size, flags=cv2.INTER_NEAREST) > 0
    moved = camera.model_copy(
        update={
            "fx": camera.fx * enlarged,
            "fy": camera.fy * enlarged,
            "cx": (camera.cx - left) * enlarged,
            "cy": (camera.cy - top) * enlarged,
        }
    )
    return draw_jaw(_outlined(part, part_mask, 1), grasp, color_from_base, moved, outcome.station.hand)


def _color_from_base(outcome: Outcome) -> npt.NDArray[np.float64]:
    return inverse(outcome.frame.observation.view.base_from_color)


def _region_px(outcome: Outcome) -> npt.NDArray[np.float64]:
    """Pixels (n, 2) along the pick region's outline on the plane z = 0, as far as it lies in front of the camera."""
    x_min, x_max, y_min, y_max = outcome.frame.region_m
    corners = np.array([(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max), (x_min, y_min)])
    steps = np.linspace(0, 1, 40)[:, None]
    edges = np.concatenate([start + (end - start) * steps for start, end in itertools.pairwise(corners)])
    points = apply(_color_from_base(outcome), np.column_stack([edges, np.zeros(len(edges))]))
    return project(points[points[:, 2] > _IN_FRONT_M], outcome.frame.observation.frame.color_camera)


def _dotted(image: Image, pixels_px: npt.NDArray[np.float64]) -> Image:
    for u, v in np.rint(pixels_px).astype(int).clip(-_FAR_PX, _FAR_PX).tolist():
        cv2.circle(image, (u, v), 1, _REGION, -1)
    return image


def _cut(image: Image, pixels_px: npt.NDArray[np.float64]) -> Image:
    """The part of the image around the pixels (n, 2); the whole image when none of them is inside."""
    height, width = image.shape[:2]
    u, v = pixels_px[:, 0].clip(0, width), pixels_px[:, 1].clip(0, height)
    part = image[int(v.min(initial=height)) : int(v.max(initial=0)), int(u.min(initial=width)) : int(u.max(initial=0))]
    return part if part.size else image


def _outlined(image: Image, mask: npt.NDArray[np.bool_], thickness_px: int) -> Image:
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    return np.asarray(cv2.drawContours(image.copy(), contours, -1, _OBJECT, thickness_px), dtype=np.uint8)


def _fitted(image: Image, size_px: tuple[int, int]) -> Image:
    """The image scaled into ``size_px`` (width, height), black around it."""
    scale = min(size_px[0] / image.shape[1], size_px[1] / image.shape[0])
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    whole = np.zeros((size_px[1], size_px[0], 3), dtype=np.uint8)
    whole[: small.shape[0], : small.shape[1]] = small
    return whole


def _caption(outcome: Outcome, width_px: int) -> Image:
    band = np.full((_CAPTION_PX, width_px, 3), 40, dtype=np.uint8)
    head = f"{outcome.frame.name}: {outcome.code} ({outcome.cpu_s:.2f} s CPU)"
    lines = [head, *textwrap.wrap(outcome.text, _LINE_CHARACTERS)[:2]]
    for row, line in enumerate(lines):
        at = (6, 16 + row * _LINE_PX)
        cv2.putText(band, line, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, _TEXT, 1, cv2.LINE_AA)
    return band
