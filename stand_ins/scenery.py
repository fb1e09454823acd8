"""Separates the object of an image from its background."""

from __future__ import annotations

import cv2
import numpy as np

from .asked import Image, Mask
from .relief import Floats, Layer

_STANDS_OUT = 24
"""Grey levels by which an object differs from its background."""
_PLATE_PX = 192


def object_of(image: Image, mask: Mask | None) -> Mask:
    """The object: what must not be edited, or without such a mask what differs from the picture's rim."""
    if mask is not None and mask.any() and not mask.all() and _rim(mask).mean() > 0.9:
        return ~mask
    rim = _rim(image).reshape(-1, 3).astype(np.int16)
    middle = np.median(rim, axis=0)
    noise = float(np.median(np.abs(rim - middle).max(axis=1)))
    apart = np.abs(image.astype(np.int16) - middle).max(axis=2) > max(_STANDS_OUT, 4 * noise)
    opened = cv2.morphologyEx(apart.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), dtype=np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(opened)
    if count < 2:
        return np.zeros(image.shape[:2], dtype=bool)
    return np.asarray(labels == 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax()))


def plate(image: Image, object_mask: Mask) -> Image:
    """The background without the object: filled in coarsely, which is all a background needs."""
    grown = cv2.dilate(object_mask.astype(np.uint8), np.ones((9, 9), dtype=np.uint8))
    size = image.shape[1::-1]
    coarse = tuple(max(8, round(side * min(1.0, _PLATE_PX / max(size)))) for side in size)
    small = cv2.resize(image, coarse, interpolation=cv2.INTER_AREA)
    gone = cv2.resize(grown * 255, coarse, interpolation=cv2.INTER_AREA) > 0
    filled = cv2.resize(
        cv2.inpaint(small, gone.astype(np.uint8), 3, cv2.INPAINT_TELEA), size, interpolation=cv2.INTER_CUBIC
    )
    return Layer(
        np.asarray(filled, dtype=np.uint8), np.asarray(cv2.GaussianBlur(grown.astype(np.float32), (0, 0), 1.5))
    ).over(image)


def _rim(pixels: Image | Mask) -> Image | Mask:
    """The picture's outermost three rows and columns."""
    flat_rows = np.concatenate([pixels[:3], pixels[-3:]]).reshape(-1, *pixels.shape[2:])
    columns = np.concatenate([pixels[:, :3], pixels[:, -3:]], axis=1).reshape(-1, *pixels.shape[2:])
    return np.concatenate([flat_rows, columns])


def center_of(mask: Mask) -> Floats:
    """(x, y) of the mask's pixels."""
    return np.asarray(np.argwhere(mask).mean(axis=0)[::-1])
