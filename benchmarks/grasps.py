"""Grasp rectangles on labelled images (Jiang et al. 2011): IoU >= 25 % and 30 degrees with at least one label."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, get_args

import cv2
import numpy as np
import numpy.typing as npt

from benchmarks.baselines.flat import flat_object, flat_rectangle
from benchmarks.baselines.outlined import imagined_rectangle, jaw_of, outlined_object, outlined_rectangle
from benchmarks.datasets.cornell import read_cornell
from benchmarks.datasets.jacquard import read_jacquard
from benchmarks.datasets.sample import Half, Sample
from benchmarks.segmenters import Segmenter, segmenter_of
from benchmarks.sheet import write_sheet
from bus.errors import CycleFailure
from bus.messages import Rectangle
from config.load import load_station
from config.schema import Station
from perception.detector import ignore_reply
from perception.geometry.crop import Mask
from perception.goal.imagine import Conversation
from perception.models import open_models
from perception.proposal import propose
from perception.rectangles.metric import MAX_APART_RAD, MIN_IOU, angle_apart_rad, iou, matches
from perception.rectangles.network import GraspNetwork

_TILE_PX, _COLUMNS = 240, 6
DETECTORS = ("vlad", "antipodal", "search")
SKIPPED = "skipped"
"""Outcome of an image without the depth that a detector needs."""

Detector = Callable[[Sample, Mask], Rectangle | None]
"""The rectangle of an image whose object is masked; None = the image lacks what this detector needs."""


class Dataset(NamedTuple):
    """A dataset: how it is read, its scale on the table, and the jaw it was labelled for."""

    read: Callable[[Path], Iterator[Sample]]
    m_per_px: float
    settings: tuple[str, ...]


DATASETS = {
    "cornell": Dataset(read_cornell, 0.0010, ("perception.rectangle_margin_m=0.010",)),
    "jacquard": Dataset(
        read_jacquard,
        0.0008,
        ("perception.rectangle_margin_m=0.004", "hand.max_width_m=0.15", "hand.finger_width_m=0.025"),
    ),
}


class Outcome(NamedTuple):
    """One image: what was predicted, or why nothing was; and what was taken for the object."""

    sample: Sample
    mask: Mask | None
    predicted: Rectangle | None
    reason: str


def run(
    dataset: str,
    root: Path,
    detector: str,
    overrides: list[str],
    tell: Callable[[str], None],
    sheet: Path | None = None,
) -> dict[str, Any]:
    """Every image of a dataset, through ``detector``; ``vlad`` is printed beside ``antipodal``, its search alone.

    Args:
        sheet: where a picture of the failures goes.
    """
    chosen = DATASETS[dataset]
    station = load_station(None, [*chosen.settings, *overrides])
    segmenter = segmenter_of(station, tell)
    detectors = {name: _detector(name, station, chosen.m_per_px) for name in _rows(detector)}
    outcomes: dict[str, list[Outcome]] = {name: [] for name in detectors}
    for sample in chosen.read(root):
        masked = _masked(sample, segmenter)
        for name, detect in detectors.items():
            outcomes[name].append(_judged(sample, masked, detect))
        tell(f"{sample.name} {' '.join(found[-1].reason for found in outcomes.values())}")
    failures = [one for one in outcomes[detector] if one.reason not in ("success", SKIPPED)]
    if sheet is not None and failures:
        contact_sheet(failures, sheet)
    return _figures(dataset, detector, outcomes, segmenter.name)


def _rows(detector: str) -> tuple[str, ...]:
    return ("vlad", "antipodal") if detector == "vlad" else (detector,)


def _figures(dataset: str, detector: str, outcomes: dict[str, list[Outcome]], segmenter: str) -> dict[str, Any]:
    asked = [one for one in outcomes[detector] if one.reason != SKIPPED]
    is_masked = all(one.sample.mask is not None for one in outcomes[detector])
    return {
        "dataset": dataset,
        "detector": detector,
        "masks": "given" if is_masked else segmenter,
        "images": len(asked),
        "skipped": len(outcomes[detector]) - len(asked),
        "success_rate": _rate(asked),
        "by_reason": Counter(one.reason for one in asked if one.reason != "success"),
        **{half: _half(half, outcomes) for half in get_args(Half)},
    }


def _half(half: Half, outcomes: dict[str, list[Outcome]]) -> dict[str, Any]:
    """Images and the success rate of every row, of one half of the objects."""
    asked = {
        name: [one for one in found if one.sample.half == half and one.reason != SKIPPED]
        for name, found in outcomes.items()
    }
    return {"images": max(map(len, asked.values())), **{name: _rate(found) for name, found in asked.items()}}


def _rate(outcomes: list[Outcome]) -> float | None:
    """Share of successes; None of nothing."""
    return sum(one.reason == "success" for one in outcomes) / len(outcomes) if outcomes else None


def _detector(name: str, station: Station, m_per_px: float) -> Detector:
    if name.startswith("onnx:"):
        network = GraspNetwork(Path(name.removeprefix("onnx:")))
        return lambda sample, mask: (
            None
            if network.needs_depth and sample.depth_m is None
            else network.detect(sample.color, sample.depth_m, mask)
        )
    models, jaw = open_models(station, {}), jaw_of(station, m_per_px)

    def vlad(sample: Sample, mask: Mask) -> Rectangle:
        models.imaginer.begin()
        observed_object = outlined_object(sample.color, mask, jaw, m_per_px, station)
        proposal = propose(Conversation(models.imaginer, ignore_reply), observed_object, models, station)
        return imagined_rectangle(proposal, observed_object, jaw)

    def whole_scene(sample: Sample, mask: Mask) -> Rectangle:
        return flat_rectangle(flat_object(sample.color, mask, m_per_px, station), station)

    return {"vlad": vlad, "antipodal": lambda sample, mask: outlined_rectangle(mask, jaw), "search": whole_scene}[name]


def _masked(sample: Sample, segmenter: Segmenter) -> Mask | CycleFailure:
    if sample.mask is not None:
        return sample.mask
    try:
        return segmenter.mask(sample.color)
    except CycleFailure as failure:
        return failure


def _judged(sample: Sample, masked: Mask | CycleFailure, detect: Detector) -> Outcome:
    if isinstance(masked, CycleFailure):
        return Outcome(sample, None, None, str(masked.failure))
    try:
        predicted = detect(sample, masked)
    except CycleFailure as failure:
        return Outcome(sample, masked, None, str(failure.failure))
    return Outcome(sample, masked, predicted, SKIPPED if predicted is None else _reason(predicted, sample))


def _reason(predicted: Rectangle, sample: Sample) -> str:
    """``success``, or what of place and angle no label agrees with."""
    if any(matches(predicted, truth) for truth in sample.truths):
        return "success"
    overlapping = [truth for truth in sample.truths if iou(predicted, truth) >= MIN_IOU]
    turned = [truth for truth in sample.truths if angle_apart_rad(predicted, truth) <= MAX_APART_RAD]
    return "angle" if overlapping else "place" if turned else "both"


def contact_sheet(outcomes: list[Outcome], path: Path) -> None:
    """Labels green, the prediction red, the outline of what was segmented blue."""
    write_sheet(path, [_tile(outcome)[..., ::-1] for outcome in outcomes], _COLUMNS)


def _tile(outcome: Outcome) -> npt.NDArray[np.uint8]:
    image = outcome.sample.color.copy()
    for truth in outcome.sample.truths:
        cv2.polylines(image, [np.rint(truth.corners_px()).astype(np.int32)], True, (40, 170, 60), 1, cv2.LINE_AA)
    if outcome.mask is not None:
        contours, _ = cv2.findContours(outcome.mask.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(image, contours, -1, (60, 80, 255), 1)
    if outcome.predicted is not None:
        cv2.polylines(
            image, [np.rint(outcome.predicted.corners_px()).astype(np.int32)], True, (230, 30, 30), 2, cv2.LINE_AA
        )
    middle = np.mean([truth.center_px for truth in outcome.sample.truths], axis=0).astype(int)
    half = min(image.shape[:2]) // 5
    left = int(np.clip(middle[0] - half, 0, image.shape[1] - 2 * half))
    top = int(np.clip(middle[1] - half, 0, image.shape[0] - 2 * half))
    tile = cv2.resize(image[top : top + 2 * half, left : left + 2 * half], (_TILE_PX, _TILE_PX))
    label = f"{outcome.sample.name[:12]} {outcome.reason}"
    return np.asarray(cv2.putText(tile, label, (4, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA))
