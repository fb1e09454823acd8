"""Segmenters on images without depth: how well each finds the object, as overlap with the masks of a dataset."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from statistics import mean
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from benchmarks.baselines.color_only import segment_by_color
from benchmarks.baselines.salient_only import segment_salient
from benchmarks.datasets.jacquard import read_jacquard
from bus.errors import ConfigError, CycleFailure
from config.load import load_station
from config.schema import Station
from perception.geometry.crop import Mask
from perception.models.salient import Salient

Image = npt.NDArray[np.uint8]


class Segmenter(NamedTuple):
    """A segmenter of images, and its name in the figures."""

    name: str
    mask: Callable[[Image], Mask]


def segmenter_of(station: Station, tell: Callable[[str], None]) -> Segmenter:
    """By saliency where the station's weights are; else by colour, which ``tell`` and the figures' ``masks`` say."""
    path = station.perception.salient.path
    if not path.is_file():
        tell(f"There are no weights {path} (`just salient` fetches them): objects are found by colour alone.")
        return Segmenter("color", segment_by_color)
    return _salient(Salient(path))


def _salient(salient: Salient) -> Segmenter:
    return Segmenter("salient", lambda color: segment_salient(color, salient))


def overlaps(root: Path, overrides: list[str], tell: Callable[[str], None]) -> dict[str, Any]:
    """Intersection over union with every mask of Jacquard: by colour, by U-2-Net, and by both.

    Raises: ConfigError without the weights.
    """
    salient = Salient(load_station(None, overrides).perception.salient.path)
    segmenter = _salient(salient)
    by_view: dict[str, dict[str, float]] = {}
    for sample in read_jacquard(root):
        if sample.mask is None:
            raise ConfigError(f"{sample.name} has no mask.", "Is the dataset whole?")
        masks = {
            "color": _found(segment_by_color, sample.color),
            "u2netp": _found(salient.object_of, sample.color),
            "both": _found(segmenter.mask, sample.color),
        }
        by_view[sample.name] = {name: _iou(mask, sample.mask) for name, mask in masks.items()}
        tell(f"{sample.name} " + ", ".join(f"{name} {value:.2f}" for name, value in by_view[sample.name].items()))
    names = ("color", "u2netp", "both")
    wins = {
        name: [view for view, row in by_view.items() if max(row, key=lambda one: row[one]) == name] for name in names
    }
    return {
        "iou": {name: mean(row[name] for row in by_view.values()) for name in names},
        "best_in": {name: len(views) for name, views in wins.items()},
        "by_view": by_view,
    }


def _found(segment: Callable[[Image], Mask], color: Image) -> Mask:
    """The mask; an empty one when nothing was found."""
    try:
        return segment(color)
    except CycleFailure:
        return np.zeros(color.shape[:2], dtype=bool)


def _iou(one: Mask, other: Mask) -> float:
    return float((one & other).sum() / max(int((one | other).sum()), 1))
