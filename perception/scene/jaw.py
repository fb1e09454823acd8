"""The things between the fingers of a grasp, as seen before: along the closing axis, one thing or two?

Frames: docs/frames.md.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from bus.messages import Detections, Grasp, Observation
from bus.transforms import apply, inverse
from config.schema import Station
from perception.geometry.depth import registered, without_flying_pixels
from perception.scene.depth_view import DepthView

_PAD_M, _ABOVE_M, _BELOW_M = 0.009, 0.05, 0.02
"""To either side across the closing axis, half a pad; and above and below the tcp."""
_BIN_M = 0.002
_LEAST_M = 0.010
"""A patch that is narrower along the closing axis is a stripe or a rim."""
_COLOR_STEP, _EVEN = 12.0, 0.3
"""Of two patches: the CIE76 distance of their colours, and the share of it by which either may vary in itself."""
_SHADED = np.array([0.3, 1.0, 1.0])
"""Lightness counts less than hue: faces are lit differently."""
_FEWEST, _REACHED = 3, 8
"""Pixels of a bin, and of a thing that reaches between the fingers."""

Array = npt.NDArray[np.float64]


class InJaw(NamedTuple):
    """The things that lay between the fingers.

    Attributes:
        others: numbers of other things of which at least 10 mm along the closing axis lay there.
        swept: numbers of other things that reached between the opened fingers, and which they may have closed on.
        has_seam: it was two even patches of different colours, side by side along the closing axis.
    """

    others: tuple[int, ...] = ()
    swept: tuple[int, ...] = ()
    has_seam: bool = False


def in_jaw(detections: Detections, grasp: Grasp, width_m: float, before: Observation, station: Station) -> InJaw:
    """Look at the colours and numbers of what lay between the fingers.

    Args:
        width_m: at which the fingers stand. ``before``: the look that is shown in ``detections``.
    """
    y_m, lab, number = _between(detections, grasp, width_m, before, station)
    cell = np.floor(y_m / _BIN_M).astype(int)
    _, _, swept = _between(detections, grasp, max(width_m, grasp.opening_m), before, station)
    counts = np.bincount(swept, minlength=1)
    reached = tuple(int(one) for one in np.flatnonzero(counts >= _REACHED) if one != grasp.instance)
    return InJaw(_beside(cell, number, grasp.instance), reached, _has_seam(cell, lab))


def _between(
    detections: Detections, grasp: Grasp, width_m: float, before: Observation, station: Station
) -> tuple[Array, Array, npt.NDArray[np.int16]]:
    """Return where pixels (n,) of things between the fingers lie along the closing axis [m]; their colours, numbers."""
    depth_m = without_flying_pixels(before.frame.depth_m)
    rgbd, source = registered(before.frame, depth_m)
    labels = detections.scene.labels
    is_thing = (labels > 0) & (source >= 0)
    points = DepthView.of(before, depth_m).points_base.reshape(-1, 3)[source[is_thing]].astype(float)
    height_m = apply(inverse(detections.scene.table.base_from_table), points)[:, 2]
    x, y, z = apply(inverse(np.asarray(grasp.base_from_tcp)), points).T
    there = (abs(x) < _PAD_M) & (abs(y) < width_m / 2) & (z < _BELOW_M) & (z > -_ABOVE_M)
    there &= height_m >= station.perception.min_object_height_m
    if not there.any():
        return np.zeros(0), np.zeros((0, 3)), np.zeros(0, dtype=np.int16)
    color = rgbd.color[is_thing][there].astype(np.float32) / 255
    lab = cv2.cvtColor(color[:, None], cv2.COLOR_RGB2LAB)[:, 0] * _SHADED
    return y[there], np.asarray(lab, dtype=float), labels[is_thing][there]


def _beside(cell: npt.NDArray[np.int64], number: npt.NDArray[np.int16], instance: int) -> tuple[int, ...]:
    """The numbers of other things to which most pixels of enough bins belong: they lie beside it, not below it."""
    most = [int(np.bincount(number[cell == one]).argmax()) for one in np.unique(cell)]
    return tuple(one for one in sorted(set(most) - {instance}) if most.count(one) * _BIN_M >= _LEAST_M)


def _has_seam(cell: npt.NDArray[np.int64], lab: Array) -> bool:
    """Whether bins (n,) with colours (n, 3) part into two even patches at one place."""
    if not len(cell):
        return False
    cell = cell - cell.min()
    count = np.bincount(cell)
    full = count >= _FEWEST
    means = np.stack([np.bincount(cell, lab[:, axis]) for axis in range(3)], axis=1)[full] / count[full, None]
    least, best = round(_LEAST_M / _BIN_M), (0.0, 1.0)
    for at in range(least, len(means) - least + 1):
        left, right = means[: max(at - 1, least - 1)], means[at + 1 :] if len(means) - at > least else means[at:]
        step = float(np.linalg.norm(np.median(left, axis=0) - np.median(right, axis=0)))
        spread = max(float(np.linalg.norm(side - np.median(side, axis=0), axis=1).mean()) for side in (left, right))
        best = max(best, (step, spread)) if spread < _EVEN * step else best
    return best[0] >= _COLOR_STEP
