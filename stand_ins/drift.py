"""Unwanted changes by image models: the object turned, tilted, stretched, recoloured, doubled."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import cv2
import numpy as np

from .asked import Image, Mask
from .relief import Floats, Layer, Pose, body, flat, spread
from .scenery import center_of, plate

_PAINTED = 16
"""Grey levels by which paint differs from what it covers."""
_OVER_SHARE = 0.12
"""A piece of paint with more of it on the object lies before it."""
_MARGIN_PX = 3.0
_HUES = 180


@dataclass(frozen=True)
class Drift:
    """The departure of a picture from what was asked for.

    Attributes:
        rotation_deg: in the image, counter-clockwise as seen, about the object's centre.
        scale: of object and rod; less where the object would leave the picture.
        shift_px: (right, down).
        tilt_deg: out of the image, about an axis in it.
        recolor: 0-1, of the object towards another hue; the rod keeps its own.
        shape: relative stretch of object and rod; the object's outline is dented as well.
        second_object: a smaller copy beside the object.
        seed: draws the directions that are not given.
    """

    rotation_deg: float = 0.0
    scale: float = 1.0
    shift_px: tuple[float, float] = (0.0, 0.0)
    tilt_deg: float = 0.0
    recolor: float = 0.0
    shape: float = 0.0
    second_object: bool = False
    rod: Literal["one", "none", "two"] = "one"
    seed: int = 0


NONE = Drift()


def mild(seed: int) -> Drift:
    """A model that follows well."""
    rng = np.random.default_rng(seed)
    rotation_deg, tilt_deg = rng.uniform(-15, 15), rng.uniform(0, 8)
    return Drift(rotation_deg, float(np.exp(rng.uniform(*np.log([0.8, 1.25])))), tilt_deg=tilt_deg, seed=seed)


def hard(seed: int) -> Drift:
    """A model that draws the object anew, any way round."""
    rng = np.random.default_rng(seed)
    rotation_deg, tilt_deg = rng.uniform(-180, 180), rng.uniform(0, 25)
    scale = float(np.exp(rng.uniform(*np.log([0.6, 1.6]))))
    return Drift(rotation_deg, scale, tilt_deg=tilt_deg, shape=0.1, seed=seed)


def apply(picture_before: Image, painted: Image, object_mask: Mask, drift: Drift) -> Image:
    """The painted picture as a model with this drift would have drawn it."""
    if replace(drift, seed=0) == NONE or not object_mask.any():
        return painted.copy()
    rng = np.random.default_rng(drift.seed)
    pose = _pose(object_mask, drift, rng)
    rods = _rods(picture_before, painted, object_mask, drift, rng)
    looks = _recolored(spread(picture_before, object_mask), rods, drift.recolor, rng)
    looks, outline = _dented(looks, object_mask, drift.shape, rng)
    layer, near = body(looks, outline, pose)
    moved = [(flat(rod.color, rod.mask, pose), rod.over) for rod in rods]
    under = [Layer(rod.color, rod.cover * (1 - near)) for rod, over in moved if not over]
    layers = [layer, *under, *(rod for rod, over in moved if over)]
    canvas = plate(picture_before, object_mask)
    if drift.second_object:
        taken = np.max([each.cover for each in layers], axis=0) > 0.1
        canvas = _beside(looks, outline, pose, taken).over(canvas)
    for each in layers:
        canvas = each.over(canvas)
    return canvas


class _Rod(NamedTuple):
    """A rod's pixels, with colours beyond them; ``over``: it lies before the object, not in it."""

    color: Image
    mask: Mask
    over: bool


def _rods(before: Image, painted: Image, object_mask: Mask, drift: Drift, rng: np.random.Generator) -> list[_Rod]:
    paint = np.abs(painted.astype(np.int16) - before).max(axis=2) > _PAINTED
    angle_deg = float(rng.uniform(55, 90) * rng.choice([-1, 1]))
    if drift.rod == "none" or not paint.any():
        return []
    color = spread(painted, paint)
    over = _crossing(paint, object_mask)
    under = paint & ~over
    within = _hidden(under, object_mask)
    rods = [_Rod(color, under | within, over=False), _Rod(color, over, over=True)]
    if drift.rod == "two":
        turn = cv2.getRotationMatrix2D(tuple(float(c) for c in center_of(object_mask)), angle_deg, 1.0)
        size = paint.shape[::-1]
        turned = np.asarray(cv2.warpAffine((paint | within).astype(np.uint8), turn, size) > 0)
        looks = cv2.warpAffine(color, turn, size, borderMode=cv2.BORDER_REPLICATE)
        shows = (turned & ~object_mask).sum() / max(1, turned.sum())
        rods.append(_Rod(np.asarray(looks, dtype=np.uint8), turned, over=bool(shows < 0.4)))
    return [rod for rod in rods if rod.mask.any()]


def _crossing(paint: Mask, object_mask: Mask) -> Mask:
    """The pieces of paint that lie visibly on the object."""
    count, labels = cv2.connectedComponents(paint.astype(np.uint8))
    inner = cv2.erode(object_mask.astype(np.uint8), np.ones((5, 5), dtype=np.uint8)) > 0
    size = np.bincount(labels.ravel(), minlength=count)
    on_object = np.bincount(labels[inner], minlength=count)
    crossing = on_object > _OVER_SHARE * size
    crossing[0] = False
    return np.asarray(crossing[labels])


def _hidden(rod: Mask, object_mask: Mask) -> Mask:
    """The stretch of the rod that the object hides, as far as its visible pieces tell."""
    if rod.sum() < 2:
        return np.zeros_like(rod)
    points = np.argwhere(rod)[:, ::-1].astype(np.float64)
    middle = points.mean(axis=0)
    _, _, axes = np.linalg.svd(points - middle, full_matrices=False)
    along, aside = (points - middle) @ axes.T[:, 0], (points - middle) @ axes.T[:, 1]
    width = max(1, round(float(np.sqrt(12) * aside.std())))
    reach = 0.05 * np.ptp(along)
    ends = [middle + axes[0] * s for s in (along.min() - reach, along.max() + reach)]
    line = np.zeros(rod.shape, dtype=np.uint8)
    start, end = (tuple(round(c) for c in point) for point in ends)
    cv2.line(line, start, end, 1, width)
    return np.asarray((line > 0) & object_mask)


def _pose(object_mask: Mask, drift: Drift, rng: np.random.Generator) -> Pose:
    """Return where object and rod go."""
    tilted, stretched = rng.uniform(0, 2 * np.pi, 2)
    center = center_of(object_mask)
    along = np.array([np.cos(stretched), np.sin(stretched)])
    more = 1 + drift.shape
    stretch = np.eye(2) / more + (more - 1 / more) * np.outer(along, along)
    axis = np.array([np.cos(tilted), np.sin(tilted)])
    turn = _rotation(drift.rotation_deg)
    pose = Pose(center, center + drift.shift_px, turn, stretch, axis, float(np.deg2rad(drift.tilt_deg)))
    return replace(pose, turn=min(drift.scale, _largest(object_mask, pose)) * turn)


def _largest(object_mask: Mask, pose: Pose) -> float:
    """The scale at which the object touches the picture's rim."""
    hull = cv2.convexHull(np.argwhere(object_mask)[:, ::-1].astype(np.int32))[:, 0]
    apart = (hull - pose.center) @ (pose.turn @ pose.stretch).T
    last = np.array(object_mask.shape[::-1]) - 1 - _MARGIN_PX
    room = np.where(apart > 0, last - pose.moved, pose.moved - _MARGIN_PX)
    return max(0.2, float((room / np.maximum(np.abs(apart), 1e-9)).min()))


def _rotation(angle_deg: float) -> Floats:
    """(2, 2), counter-clockwise as seen: y points down."""
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    return np.array([[c, s], [-s, c]])


def _beside(looks: Image, outline: Mask, pose: Pose, taken: Mask) -> Layer:
    """A copy in the largest free spot."""
    free = cv2.distanceTransform(np.pad(~taken, 1).astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
    spot = np.array(np.unravel_index(int(free.argmax()), free.shape)[::-1], dtype=np.float64)
    hull = np.argwhere(outline)[:, ::-1] - pose.center
    radius = float(np.linalg.norm(hull, axis=1).max())
    scale = min(0.8, 0.9 * float(free.max()) / radius)
    return flat(looks, outline, replace(pose, moved=spot, turn=scale * _rotation(70.0), tilt_rad=0.0))


def _recolored(looks: Image, rods: list[_Rod], share: float, rng: np.random.Generator) -> Image:
    """Towards a hue far from the rod's."""
    aside = int(rng.integers(45, 136))
    if share == 0:
        return looks
    hsv = cv2.cvtColor(looks, cv2.COLOR_RGB2HSV)
    rod_hue = int(np.median(_hues(rods[0].color[rods[0].mask]))) if rods else 0
    hsv[..., 0] = (rod_hue + aside) % _HUES
    hsv[..., 1] = np.maximum(hsv[..., 1], 130)
    other = cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)
    return np.asarray(cv2.addWeighted(looks, 1 - share, other, share, 0), dtype=np.uint8)


def _hues(colors: Image) -> Image:
    return np.asarray(cv2.cvtColor(colors[:, None], cv2.COLOR_RGB2HSV)[:, 0, 0])


def _dented(looks: Image, mask: Mask, shape: float, rng: np.random.Generator) -> tuple[Image, Mask]:
    """Smooth bumps of the outline, a fraction of the object's size."""
    phases = rng.uniform(0, 2 * np.pi, 2)
    if shape == 0:
        return looks, mask
    radius = float(np.sqrt(mask.sum() / np.pi))
    y, x = np.mgrid[: mask.shape[0], : mask.shape[1]].astype(np.float32)
    wave, high = 2 * np.pi / (2.2 * radius), 0.35 * shape * radius
    x, y = (
        np.asarray(x + high * np.sin(wave * y + phases[0]), dtype=np.float32),
        np.asarray(y + high * np.sin(wave * x + phases[1]), dtype=np.float32),
    )
    color = cv2.remap(looks, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(color, dtype=np.uint8), np.asarray(
        cv2.remap(mask.astype(np.float32), x, y, cv2.INTER_LINEAR) > 0.5
    )
