"""Grasp rectangles on labelled images (Jiang et al. 2011): IoU >= 25 % and 30 degrees with at least one label."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from benchmarks.baselines.color_only import segment_by_color
from benchmarks.baselines.flat import flat_object, flat_rectangle
from benchmarks.datasets.cornell import read_cornell
from benchmarks.datasets.jacquard import read_jacquard
from benchmarks.datasets.sample import Sample
from benchmarks.sheet import write_sheet
from bus.errors import CycleFailure
from bus.messages import Rectangle
from config.load import load_station
from config.schema import Station
from perception.detector import ignore_reply
from perception.goal.imagine import Conversation
from perception.models import open_models
from perception.proposal import grasps_of, propose
from perception.rectangles.metric import MAX_APART_RAD, MIN_IOU, angle_apart_rad, iou, matches
from perception.rectangles.network import GraspNetwork

_TILE_PX, _COLUMNS = 240, 6

Detector = Callable[[Sample], Rectangle]


class Dataset(NamedTuple):
    """How it is read, its scale on the table, and the jaw it was labelled for."""

    read: Callable[[Path], Iterator[Sample]]
    m_per_px: float
    settings: tuple[str, ...]


DATASETS = {
    "cornell": Dataset(read_cornell, 0.0010, ("perception.rectangle_margin_m=0.006",)),
    "jacquard": Dataset(
        read_jacquard,
        0.0008,
        ("perception.rectangle_margin_m=0.004", "hand.max_width_m=0.15", "hand.finger_width_m=0.025"),
    ),
}


class Outcome(NamedTuple):
    """One image: what was predicted, or why nothing was."""

    sample: Sample
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
    """Every image of a dataset; ``sheet``: where a picture of the failures goes."""
    chosen = DATASETS[dataset]
    detect = _detector(detector, load_station(None, [*chosen.settings, *overrides]), chosen.m_per_px)
    outcomes = []
    for sample in chosen.read(root):
        outcomes.append(_judged(sample, detect))
        tell(f"{sample.name} {outcomes[-1].reason}")
    failures = [outcome for outcome in outcomes if outcome.reason != "success"]
    if sheet is not None and failures:
        contact_sheet(failures, sheet)
    return {
        "dataset": dataset,
        "detector": detector,
        "images": len(outcomes),
        "success_rate": 1 - len(failures) / max(len(outcomes), 1),
        "by_reason": Counter(outcome.reason for outcome in failures),
    }


def _detector(name: str, station: Station, m_per_px: float) -> Detector:
    if name.startswith("onnx:"):
        network = GraspNetwork(Path(name.removeprefix("onnx:")))
        return lambda sample: network.detect(sample.color, sample.depth_m)
    models = open_models(station, {})

    def vlad(sample: Sample) -> Rectangle:
        models.imaginer.begin()
        observed_object = flat_object(sample.color, _mask(sample), m_per_px, station)
        proposal = propose(Conversation(models.imaginer, ignore_reply), observed_object, models, station)
        try:
            return proposal.rectangles[grasps_of(proposal, observed_object, station)[0].rectangle]
        except CycleFailure:  # the made-up height forbids it; the rectangle is the paper's all the same
            return proposal.rectangles[-1]

    def antipodal(sample: Sample) -> Rectangle:
        return flat_rectangle(flat_object(sample.color, _mask(sample), m_per_px, station), station)

    return {"vlad": vlad, "antipodal": antipodal}[name]


def _mask(sample: Sample) -> npt.NDArray[np.bool_]:
    return sample.mask if sample.mask is not None else segment_by_color(sample.color)


def _judged(sample: Sample, detect: Detector) -> Outcome:
    try:
        predicted = detect(sample)
    except CycleFailure as failure:
        return Outcome(sample, None, str(failure.failure))
    if any(matches(predicted, truth) for truth in sample.truths):
        return Outcome(sample, predicted, "success")
    overlapping = [truth for truth in sample.truths if iou(predicted, truth) >= MIN_IOU]
    turned = [truth for truth in sample.truths if angle_apart_rad(predicted, truth) <= MAX_APART_RAD]
    return Outcome(sample, predicted, "angle" if overlapping else "place" if turned else "both")


def contact_sheet(outcomes: list[Outcome], path: Path) -> None:
    """Labels green, the prediction red, the outline of what was segmented blue."""
    write_sheet(path, [_tile(outcome)[..., ::-1] for outcome in outcomes], _COLUMNS)


def _tile(outcome: Outcome) -> npt.NDArray[np.uint8]:
    image = outcome.sample.color.copy()
    for truth in outcome.sample.truths:
        cv2.polylines(image, [np.rint(truth.corners_px()).astype(np.int32)], True, (40, 170, 60), 1, cv2.LINE_AA)
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
