"""The outline of one object in the colour image: holes without depth are closed, and the rim is redrawn by colour."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from perception.geometry.crop import Crop

_AROUND_PX = 12
_CLOSED_PX = 7
_MIN_AREA_PX = 150
_DISK = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))
_SEEN_THROUGH = 0.4
"""A hole stays open when more than this share of it has depth: the table is seen through it."""
_SAMPLES = 3000
_CONFUSED = 0.05
"""Colour is ignored when more than this share of the surroundings has the object's colour."""

Mask = npt.NDArray[np.bool_]
Array = npt.NDArray[np.float64]


def outlined(cluster: Mask, seen: Mask, color: npt.NDArray[np.uint8]) -> Mask:
    """Return the whole outline (H, W) of a cluster of pixels (H, W).

    Args:
        seen: (H, W) the pixels with depth. ``color``: (H, W, 3) RGB.
    """
    crop = Crop.around(cluster, _AROUND_PX)
    whole = _filled(crop.of(cluster), crop.of(seen))
    return crop.back(refined_by_color(crop.of(color), whole), np.zeros_like(cluster))


def _filled(mask: Mask, seen: Mask) -> Mask:
    """The mask without holes that only missing depth causes: dark, shiny or steep parts inside the outline."""
    closed = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, _DISK)
    contours, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    whole = cv2.drawContours(np.zeros_like(closed), contours, -1, 1, cv2.FILLED)
    count, holes = cv2.connectedComponents(whole - closed)
    # A hole through which the table is seen stays open.
    see_through = [label for label in range(1, count) if seen[holes == label].mean() > _SEEN_THROUGH]
    return np.asarray((whole > 0) & ~np.isin(holes, see_through))


def refined_by_color(color: npt.NDArray[np.uint8], mask: Mask) -> Mask:
    """Return the mask (H, W), its rim redrawn where object and surroundings differ in colour: depth edges are ragged.

    Only a band of 3 pixels on either side of the outline may change.
    """
    part = mask.astype(np.uint8)
    lab = cv2.cvtColor(cv2.blur(color, (3, 3)), cv2.COLOR_RGB2LAB).astype(np.float32)
    core, whole = cv2.erode(part, _DISK) > 0, cv2.dilate(part, _DISK) > 0
    beside = (cv2.dilate(part, _DISK, iterations=3) > 0) & ~whole
    if core.sum() < _MIN_AREA_PX or beside.sum() < _MIN_AREA_PX:
        return mask
    band = whole & ~core
    ours, others = _sampled(lab[core]), _sampled(lab[beside])
    nearer = _distance(lab[band], ours) < _distance(lab[band], others)
    if (_distance(others, ours) < _distance(others, others)).mean() > _CONFUSED:
        return mask
    redrawn = core.copy()
    redrawn[band] = nearer
    return np.asarray(cv2.morphologyEx(redrawn.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3))) > 0)


def _sampled(lab: Array) -> Array:
    """About `_SAMPLES` of the colours (n, 3), evenly picked."""
    return lab[:: max(1, len(lab) // _SAMPLES)]


def _distance(lab: Array, samples: Array) -> Array:
    """Gaussian cost (n,) of colours (n, 3) under the samples' mean and covariance."""
    mean, covariance = samples.mean(axis=0), np.cov(samples.T) + 4.0 * np.eye(3)
    off = lab - mean
    return np.asarray((off @ np.linalg.inv(covariance) * off).sum(axis=-1) + np.log(np.linalg.det(covariance)))
