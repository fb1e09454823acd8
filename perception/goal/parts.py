"""Segments a goal image: the rod by the colour it was asked for, the object as the largest remaining part."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from bus.codes import Code
from bus.errors import CycleFailure
from perception.geometry.color import hue_of
from perception.geometry.crop import Mask
from perception.geometry.window import Window
from perception.models.salient import Salient
from perception.observed_object import ObservedObject

_HUE_APART, _MIN_SATURATION, _MIN_VALUE = 8, 110, 60
_STANDS_OUT = 24
"""Grey levels of the largest channel: more than compression and model noise cause."""
_MIN_ROD_PX = 60
_MIN_PART = 0.02
"""Parts below this share of the foreground are treated as noise."""
_BRIDGE_PX = 5

Image = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class GoalParts:
    """The parts of a goal image.

    Attributes:
        rod, object: (H, W) masks.
        others: (H, W) mask of everything else that is not connected to the object or its rod.
    """

    rod: Mask
    object: Mask
    others: Mask


def take_apart(image: Image, observed_object: ObservedObject, salient: Salient | None = None) -> GoalParts:
    """Segment a goal image (H, W, 3) on its plain background into rod, object and others.

    Args:
        salient: draws the object's outline; without it the object is what differs from the background.

    Raises: CycleFailure(MODEL_NO_ROD) without a rod, MODEL_DRIFT without an object.
    """
    rod = _rod(image, observed_object.rod.rgb)
    if rod.sum() < _MIN_ROD_PX:
        raise CycleFailure(Code.MODEL_NO_ROD, "There is no rod in the goal image.")
    window = Window.around(observed_object.mask)
    background = background_color(image, window, observed_object.background)
    rim = cv2.dilate(rod.astype(np.uint8), np.ones((3, 3))) > 0
    foreground = (np.abs(image.astype(np.int16) - background).max(axis=2) > _STANDS_OUT) & ~rim
    foreground = cv2.morphologyEx(foreground.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3))) > 0
    labels, areas = _labelled(foreground, rod)
    if not len(areas) or areas.max() == 0:
        raise CycleFailure(Code.MODEL_DRIFT, "There is nothing but a rod in the goal image.")
    chosen = labels == int(areas.argmax())
    small = np.flatnonzero(areas < _MIN_PART * areas.max())
    others = foreground & ~chosen & ~np.isin(labels, small)
    whole = foreground & chosen
    if salient is not None:
        whole = salient.outlined(image, whole) & ~rim
    return GoalParts(rod, whole, others & ~whole)


def _rod(image: Image, rgb: tuple[int, int, int]) -> Mask:
    hsv = cv2.cvtColor(image, cv2.COLOR_RGB2HSV).astype(np.int16)
    apart = np.abs(hsv[..., 0] - hue_of(rgb))
    vivid = (hsv[..., 1] > _MIN_SATURATION) & (hsv[..., 2] > _MIN_VALUE)
    rod = (np.minimum(apart, 180 - apart) < _HUE_APART) & vivid
    return np.asarray(cv2.morphologyEx(rod.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3))) > 0)


def background_color(image: Image, window: Window, expected: tuple[int, int, int]) -> npt.NDArray[np.int16]:
    """Return the background's colour (3,): the median along the rim of the window, where no object belongs."""
    part = window.cut(image, expected)
    rim = np.concatenate([part[:3].reshape(-1, 3), part[-3:].reshape(-1, 3), part[:, 0], part[:, -1]])
    return np.asarray(np.median(rim, axis=0), dtype=np.int16)


def _labelled(foreground: Mask, rod: Mask) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int64]]:
    """Component labels (H, W) and areas [px]; parts that only the rod or a small gap separates are one component."""
    joined = cv2.dilate((foreground | rod).astype(np.uint8), np.ones((_BRIDGE_PX, _BRIDGE_PX)))
    _, labels = cv2.connectedComponents(joined)
    labels = np.asarray(labels, dtype=np.int32)
    areas = np.bincount(labels[foreground], minlength=int(labels.max()) + 1)
    areas[0] = 0
    return labels, areas
