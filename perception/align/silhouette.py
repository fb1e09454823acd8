"""Similarities in the image that lay one silhouette on another: all in-plane angles are tried, the best are refined.

Pixels are (u, v) of the undistorted colour image; see docs/frames.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from perception.align.base import Array, Mask, Shape
from perception.geometry.lift import subsample

_ANGLES = 36
_CONTOUR_POINTS = 120
_INTERIOR_POINTS = 120
_ITERATIONS = 6
_OUTSIDE_WEIGHT = 0.25
"""Cost of a goal pixel outside the observed object, in rms radii."""


@dataclass(frozen=True)
class Similarity:
    """goal pixel -> observed pixel: ``scale * R(angle_rad) @ (pixel - goal_center_px) + observed_center_px``.

    Attributes:
        angle_rad: in-plane turn from u towards v. ``scale``: dimensionless.
        goal_center_px, observed_center_px: (2,) = (u, v).
    """

    angle_rad: float
    scale: float
    goal_center_px: Array
    observed_center_px: Array

    def __call__(self, pixels: Array) -> Array:
        return np.asarray(
            self.scale * (pixels - self.goal_center_px) @ _turn(self.angle_rad).T + self.observed_center_px
        )


def outline(shape: Shape) -> Mask:
    """Return the silhouette (H, W) of the object, with the band below the rod closed."""
    if not shape.hidden.any():
        return shape.mask
    rows, columns = np.nonzero(shape.mask | shape.hidden)
    window = np.s_[max(0, rows.min() - 1) : rows.max() + 2, max(0, columns.min() - 1) : columns.max() + 2]
    hidden = shape.hidden[window].astype(np.uint8)
    reach = int(np.ceil(2 * cv2.distanceTransform(np.pad(hidden, 1), cv2.DIST_L2, 3).max())) + 3
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach | 1, reach | 1))
    inside = np.pad(shape.mask[window].astype(np.uint8), reach)
    closed = cv2.morphologyEx(inside, cv2.MORPH_CLOSE, kernel)[reach:-reach, reach:-reach] > 0
    whole = shape.mask.copy()
    whole[window] |= closed & shape.hidden[window]
    return whole


def silhouette_fits(goal: Mask, observed: Mask, most: int) -> list[Similarity]:
    """Return the best similarities between two silhouettes (H, W), at most ``most`` of them, the best first.

    They are the local minima of the loss over the angle, each refined on the contours.
    """
    scene, picture = _Outline(observed), _Outline(goal)
    scale = scene.radius_px / picture.radius_px
    angles = np.arange(_ANGLES) * 2 * np.pi / _ANGLES
    losses = _losses(angles, scale, picture, scene)
    lowest = (losses <= np.roll(losses, 1)) & (losses < np.roll(losses, -1))
    starts = sorted(np.flatnonzero(lowest), key=lambda index: float(losses[index]))[:most]
    tried = [Similarity(float(angles[index]), scale, picture.center_px, scene.center_px) for index in starts]
    return sorted((_refined(one, picture, scene) for one in tried), key=lambda one: _loss(one, picture, scene))


class _Outline:
    """The contour of a silhouette, a sample of its inside, and the distances to the contour around it [px]."""

    def __init__(self, mask: Mask) -> None:
        rows, columns = np.nonzero(mask)
        pixels = np.stack([columns, rows], axis=1).astype(float)
        self.center_px = pixels.mean(axis=0)
        self.radius_px = float(np.sqrt(((pixels - self.center_px) ** 2).sum(axis=1).mean()))
        self.interior = subsample(pixels, _INTERIOR_POINTS)
        pad = int(self.radius_px) + 2
        self._corner = np.array([columns.min() - pad, rows.min() - pad])
        size = np.array([columns.max(), rows.max()]) + pad + 1 - self._corner
        local = np.zeros((size[1], size[0]), dtype=np.uint8)
        local[rows - self._corner[1], columns - self._corner[0]] = 1
        contours, _ = cv2.findContours(local, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        contour = np.concatenate([part[:, 0] for part in contours])
        self.contour = subsample(contour + self._corner.astype(float), _CONTOUR_POINTS)
        beside = np.ones(local.shape, dtype=np.uint8)
        beside[contour[:, 1], contour[:, 0]] = 0
        self._distance_px: npt.NDArray[np.float32] = np.asarray(cv2.distanceTransform(beside, cv2.DIST_L2, 3))
        self._inside = local > 0

    def distance_px(self, pixels: Array) -> Array:
        """Distance (...) of pixels (..., 2) to the contour; beyond the window, the distance at its rim."""
        return np.asarray(self._distance_px[self._cells(pixels)], dtype=float)

    def outside(self, pixels: Array) -> Array:
        """Share (...) of the pixels (..., n, 2) that are outside the object."""
        return np.asarray(1 - self._inside[self._cells(pixels)].mean(axis=-1))

    def _cells(self, pixels: Array) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """Row and column of pixels (..., 2) in the window."""
        cells = np.rint(pixels - self._corner).astype(np.int64)
        height, width = self._inside.shape
        return np.clip(cells[..., 1], 0, height - 1), np.clip(cells[..., 0], 0, width - 1)


def _losses(angles_rad: Array, scale: float, goal: _Outline, observed: _Outline) -> Array:
    """`_loss` (n,) of in-plane turns ``angles_rad`` (n,) about the centres, at one scale."""
    turns = np.stack([_turn(angle) for angle in angles_rad])
    forth = scale * (goal.contour - goal.center_px) @ turns.transpose(0, 2, 1) + observed.center_px
    back = (observed.contour - observed.center_px) @ turns / scale + goal.center_px
    inside = scale * (goal.interior - goal.center_px) @ turns.transpose(0, 2, 1) + observed.center_px
    contour_px = (observed.distance_px(forth).mean(axis=1) + goal.distance_px(back).mean(axis=1) * scale) / 2
    return np.asarray(contour_px / observed.radius_px + _OUTSIDE_WEIGHT * observed.outside(inside))


def _loss(fit: Similarity, goal: _Outline, observed: _Outline) -> float:
    """Mean contour distance in both directions, in rms radii, plus the weighted share of interior off the object."""
    back = Similarity(-fit.angle_rad, 1 / fit.scale, fit.observed_center_px, fit.goal_center_px)
    forth_px = observed.distance_px(fit(goal.contour)).mean()
    back_px = goal.distance_px(back(observed.contour)).mean() * fit.scale
    outside = float(observed.outside(fit(goal.interior)))
    return float((forth_px + back_px) / 2 / observed.radius_px) + _OUTSIDE_WEIGHT * outside


def _refined(fit: Similarity, goal: _Outline, observed: _Outline) -> Similarity:
    """``fit`` refined by a few steps of two-way closest contour points and the closed form."""
    observed_tree = cKDTree(observed.contour)
    for _ in range(_ITERATIONS):
        moved = fit(goal.contour)
        forth = observed_tree.query(moved)[1]
        back = cKDTree(moved).query(observed.contour)[1]
        pairs_goal = np.concatenate([goal.contour, goal.contour[back]])
        pairs_observed = np.concatenate([observed.contour[forth], observed.contour])
        fit = _closed_form(pairs_goal, pairs_observed)
    return fit


def _closed_form(goal: Array, observed: Array) -> Similarity:
    """The least-squares similarity of corresponding pixels (n, 2), as complex numbers."""
    goal_center, observed_center = goal.mean(axis=0), observed.mean(axis=0)
    a = (goal - goal_center) @ np.array([1, 1j])
    b = (observed - observed_center) @ np.array([1, 1j])
    factor = (b * a.conj()).sum() / max(float((np.abs(a) ** 2).sum()), 1e-12)
    return Similarity(float(np.angle(factor)), float(abs(factor)), goal_center, observed_center)


def _turn(angle_rad: float) -> Array:
    """Rotation (2, 2) by an angle from u towards v."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s], [s, c]])
