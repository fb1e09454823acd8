"""The segmenter for images without depth: what stands out, in form or else in colour, less the surface it encloses.

A salient-object network fills what an object encloses - the ring of a roll of tape, the space between the temples of a
pair of glasses -; there the surface is seen, and the jaw can go.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from benchmarks.baselines.color_only import segment_by_color
from perception.geometry.crop import Crop, Mask
from perception.models.salient import Salient

_AROUND, _LEAST_AROUND_PX = 0.35, 14
"""Surface that is looked at, over the object's larger extent."""
_BESIDE_PX = 7
_ALIKE = 3.0
"""Standard deviations of the surface's colour: nearer is surface."""
_LEAST_LAB = 0.6
_OPEN_PX = 5
_LEAST_SHARE, _LEAST_PX = 0.002, 40
"""Smaller pieces of seeming surface are left to the object."""

Image = npt.NDArray[np.uint8]
Array = npt.NDArray[np.float64]


def segment_salient(color: Image, salient: Salient) -> Mask:
    """The object on a plain surface (H, W). Raises: CycleFailure(NO_OBJECT, TARGET_NOT_FOUND) when nothing stands out.

    What is too small or too pale to be noticed for sure is noticed by its colour; its outline is the network's.
    """
    noticed = salient.noticed(color)
    return without_surface(color, salient.near(color, segment_by_color(color) if noticed is None else noticed))


def without_surface(color: Image, mask: Mask) -> Mask:
    """The largest part of a mask (H, W) that is left without what looks like the surface beside it."""
    rows, columns = np.nonzero(mask)
    crop = Crop.around(mask, max(_LEAST_AROUND_PX, int(_AROUND * max(np.ptp(rows), np.ptp(columns)))))
    part = crop.of(mask)
    alike = (_off_surface(crop.of(color), part) < _ALIKE) & part
    opened = cv2.morphologyEx(alike.astype(np.uint8), cv2.MORPH_OPEN, np.ones((_OPEN_PX, _OPEN_PX)))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(opened)
    least = max(_LEAST_PX, _LEAST_SHARE * part.sum())
    open_places = [label for label in range(1, count) if stats[label, cv2.CC_STAT_AREA] > least]
    left = part & ~np.isin(labels, open_places)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(left.astype(np.uint8))
    if count < 2:
        return mask
    largest = labels == 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
    return crop.back(largest, np.zeros_like(mask))


def _off_surface(color: Image, mask: Mask) -> Array:
    """Distance (H, W) of every pixel's CIELAB colour from the surface's there, in standard deviations of the surface.

    The surface's colour is a quadratic function of the place, fitted beside the mask: light falls off and casts shade.
    """
    lab = cv2.cvtColor(cv2.GaussianBlur(color, (3, 3), 0).astype(np.float32) / 255, cv2.COLOR_RGB2LAB).astype(float)
    beside = ~(cv2.dilate(mask.astype(np.uint8), np.ones((_BESIDE_PX, _BESIDE_PX))) > 0)
    v, u = (np.linspace(-0.5, 0.5, side) for side in mask.shape)
    v, u = np.meshgrid(v, u, indexing="ij")
    place = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)
    known, seen = place[beside], lab[beside]
    kept = np.ones(len(known), dtype=bool)
    for _ in range(3):
        fit = np.linalg.lstsq(known[kept], seen[kept], rcond=None)[0]
        off = np.linalg.norm(seen - known @ fit, axis=1)
        kept = off < 3 * max(1.4826 * float(np.median(off[kept])), 1.0)
    spread = np.maximum((seen - known @ fit)[kept].std(axis=0), _LEAST_LAB)
    return np.asarray(np.sqrt((((lab - place @ fit) / spread) ** 2).sum(axis=-1)))
