"""Grasp rectangles from an object's outline alone, for images without depth. In pixels (u, v); see docs/frames.md.

Two points of the outline that face each other are a closing; where the object is wider than the jaw, its upper rim is
one, because a camera that looks down at an angle sees the far rim of what is hollow at the top of the outline.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from bus.messages import Rectangle

_SMOOTHING_PX = 2.0
_CONTOUR_POINTS = 260
_MOST = 1500
"""Closings that are scored; of more, every second or third is."""
_FACING_COS = 0.8
_RAYS = 7
_FINGER_THICKNESS = 0.5
"""Of a finger along the closing axis, over its width."""
_WEIGHTS = {"off_center": -0.87, "run": -2.84, "facing": 1.77, "filled": 1.99, "blocked": -3.46}
_BIAS = 0.24
"""Logistic regression of "a label agrees" on the closings in the 76 development images of Cornell; the weights fitted
without one object find a right closing on that object about as often (0.91) as those fitted with it (0.92)."""
_RIM_SCORE = (0.60, 0.05)
"""Score of a rim at the top of the outline, and how much less it is at the bottom; chosen on the same images."""
_RIM_STEP, _RIM_RUN = 12, 0.5
"""Outline points between two rims that are offered; thickness of a wall over the width of a finger."""
_HEIGHT = 0.6
"""Least height of a rectangle over its width: labels are taller than a finger where the object is wide."""

Mask = npt.NDArray[np.bool_]
Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Jaw:
    """A parallel jaw at the object's scale in the image.

    Attributes:
        opening_px: its largest. ``finger_px``: width of a finger, across the closing axis.
        room_px: free space that a rectangle leaves on each side of the object.
    """

    opening_px: float
    finger_px: float
    room_px: float


@dataclass(frozen=True)
class Closing:
    """One way to close the jaw on the object.

    Attributes:
        center_px: (u, v) between the contacts. ``angle_rad``: of the closing axis, in [0, pi).
        run_px: from contact to contact.
        score: estimated share of labels' authors who would agree, 0 to 1.
        is_rim: it closes on the wall of something that is wider than the jaw.
    """

    center_px: tuple[float, float]
    angle_rad: float
    run_px: float
    score: float
    is_rim: bool

    def rectangle(self, jaw: Jaw) -> Rectangle:
        """Its grasp rectangle."""
        return rectangle_along(self.ends_px(), jaw)

    def ends_px(self) -> Array:
        """Return the contacts (2, 2) as (u, v)."""
        along = self.run_px / 2 * np.array([np.cos(self.angle_rad), np.sin(self.angle_rad)])
        return np.array(self.center_px) + np.stack([-along, along])


def rectangle_along(ends_px: Array, jaw: Jaw) -> Rectangle:
    """Return the grasp rectangle that closes on two contacts (2, 2) as (u, v)."""
    along, (u, v) = ends_px[1] - ends_px[0], ends_px.mean(axis=0)
    width_px = float(np.linalg.norm(along)) + 2 * jaw.room_px
    return Rectangle(
        center_px=(float(u), float(v)),
        angle_rad=float(np.arctan2(along[1], along[0]) % np.pi),
        width_px=width_px,
        height_px=max(jaw.finger_px, _HEIGHT * width_px),
    )


def closings(mask: Mask, jaw: Jaw) -> list[Closing]:
    """Every closing on the object's mask (H, W) that fits the jaw, the best first; none for an empty mask."""
    points, inward = _contour(mask)
    if len(points) < 3:
        return []
    found = [*_across(mask, points, inward, jaw), *_rims(points, inward, jaw)]
    return sorted(found, key=lambda one: -one.score)


def _contour(mask: Mask) -> tuple[Array, Array]:
    """Points (n, 2) along the smoothed outline, holes included, and their normals (n, 2) towards the object."""
    smooth = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), _SMOOTHING_PX)
    contours, _ = cv2.findContours((smooth > 0.5).astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    points = np.concatenate([np.zeros((0, 2), int), *(contour[:, 0] for contour in contours)])
    points = points[:: max(1, -(-len(points) // _CONTOUR_POINTS))]
    v, u = (gradient[points[:, 1], points[:, 0]] for gradient in np.gradient(smooth))
    normals = np.stack([u, v], axis=1).astype(float)
    return points.astype(float), normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)


def _across(mask: Mask, points: Array, inward: Array, jaw: Jaw) -> list[Closing]:
    """Closings between two points that face each other, with room on both sides."""
    i, j = np.triu_indices(len(points), k=1)
    apart, axis = points[j] - points[i], inward[i] - inward[j]
    axis = axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-9)
    run, beside = (apart * axis).sum(axis=1), np.abs(apart[:, 0] * axis[:, 1] - apart[:, 1] * axis[:, 0])
    facing = np.minimum((inward[i] * axis).sum(axis=1), -(inward[j] * axis).sum(axis=1))
    fits = np.flatnonzero(
        (facing > _FACING_COS)
        & (beside < jaw.finger_px / 2)
        & (run > 2)
        & (run + 1 + 2 * jaw.room_px <= jaw.opening_px)
    )
    fits = fits[:: max(1, -(-len(fits) // _MOST))]
    center, axis, run, facing = ((points[i] + points[j]) / 2)[fits], axis[fits], run[fits] + 1, facing[fits]
    if not len(fits):
        return []
    facing = (facing - _FACING_COS) / (1 - _FACING_COS)
    terms = {"run": run / jaw.opening_px, "facing": facing, **_matter(mask, center, axis, run, jaw)}
    score = _score(terms | {"off_center": _off_center(mask, center)})
    angle = np.arctan2(axis[:, 1], axis[:, 0]) % np.pi
    columns = (column.tolist() for column in (center, angle, run, score))
    return [Closing((u, v), turn, wide, good, False) for (u, v), turn, wide, good in zip(*columns, strict=True)]


def _score(terms: dict[str, Array]) -> Array:
    return np.asarray(1 / (1 + np.exp(-_BIAS - sum(_WEIGHTS[name] * value for name, value in terms.items()))))


def _matter(mask: Mask, center: Array, axis: Array, run: Array, jaw: Jaw) -> dict[str, Array]:
    """Shares (n,): ``filled``, of the space between the fingers that is object; ``blocked``, of the fuller finger's."""
    reach = float(run.max()) / 2 + _FINGER_THICKNESS * jaw.finger_px + 2
    t, lateral = np.arange(-reach, reach + 0.5), np.linspace(-0.5, 0.5, _RAYS) * jaw.finger_px
    u, v = (
        center[:, k, None, None] + axis[:, k, None, None] * t + side * axis[:, 1 - k, None, None] * lateral[:, None]
        for k, side in ((0, -1.0), (1, 1.0))
    )
    inside = (u > -0.5) & (v > -0.5) & (u < mask.shape[1] - 0.5) & (v < mask.shape[0] - 0.5)
    columns, rows = np.rint(np.where(inside, u, 0)).astype(int), np.rint(np.where(inside, v, 0)).astype(int)
    matter = (mask[rows, columns] & inside).mean(axis=1)  # (n, t), over the rays
    out = np.abs(t)[None] - run[:, None] / 2
    finger = (out > 1) & (out <= 1 + _FINGER_THICKNESS * jaw.finger_px)
    sides = [_mean(matter, finger & (t > 0)), _mean(matter, finger & (t < 0))]
    return {"filled": _mean(matter, out <= 0), "blocked": np.maximum(*sides)}


def _mean(values: Array, where: Mask) -> Array:
    return np.asarray((values * where).sum(axis=1) / np.maximum(where.sum(axis=1), 1))


def _off_center(mask: Mask, center: Array) -> Array:
    """Distance (n,) from the object's middle in rms radii, at most 2."""
    v, u = np.nonzero(mask)
    pixels = np.stack([u, v], axis=1)
    middle = pixels.mean(axis=0)
    radius_px = float(np.sqrt(((pixels - middle) ** 2).sum(axis=1).mean()))
    return np.asarray(np.minimum(np.linalg.norm(center - middle, axis=1) / max(radius_px, 1.0), 2.0))


def _rims(points: Array, inward: Array, jaw: Jaw) -> list[Closing]:
    """Closings on the wall along the outline; those further up in the image score more."""
    summit = np.flatnonzero(points[:, 1] <= points[:, 1].min() + 1)
    middle = np.abs(points[summit, 0] - points[summit, 0].mean()).argmin()
    some = np.concatenate([[summit[middle]], np.arange(0, len(points), _RIM_STEP)])
    run_px = _RIM_RUN * jaw.finger_px
    centers = points[some] + inward[some] * run_px / 2
    angles = np.arctan2(inward[some, 1], inward[some, 0]) % np.pi
    low = (points[some, 1] - points[:, 1].min()) / max(np.ptp(points[:, 1]), 1.0)
    return [
        Closing((float(u), float(v)), float(angle), run_px, _RIM_SCORE[0] - _RIM_SCORE[1] * float(depth), True)
        for (u, v), angle, depth in zip(centers, angles, low, strict=True)
    ]
