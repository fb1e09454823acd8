"""The heights along the closing axis: where the pads touch, how the faces there lean, what is below the fingers.

All in the map's level frame, as `perception.grasps.closing`. Lengths in metres, angles in radians.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from config.devices import HandSettings
from perception.scene.heightmap import HeightMap, Labels

LEVELS_M = np.array([0.0015, 0.006, 0.012, 0.018], dtype=np.float32)
"""Heights above the finger tips at which contacts are looked for."""
RAYS_M = np.linspace(-0.009, 0.009, 7, dtype=np.float32)
"""Places of the rays across the finger."""
_STEP_M = 0.001
_REACH_BEYOND_M = 0.014
_NEAR_PATCH_M = 0.003
_FACE_M = 0.006
"""So far behind the first contact the face goes on: two rays alone, where a pad's edge meets a round one, are level."""
_INSET_M = 0.0005
"""How much too wide each side reads: a cell is as high as its highest point, so faces seem half a cell farther out."""
_INSIDE_M = (0.001, 0.0025)
"""The edge is the surface so far inside a contact."""
_OWN_M, _BESIDE_M = 0.005, 0.002
"""So near to a contact is the held object, whose face the finger may nearly touch; other things keep so far beside."""
_VALLEY_M = (0.002, 0.010)
_ANOTHER_M, _BLUNT = 0.012, 0.1
"""A face that lies so much farther back is another one; a slope as small as depth noise makes at a rim is none."""

Array = npt.NDArray[np.float64]
Rays = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Touch:
    """The first touch of the pads along the closing axis (n,); zeros where they touch nothing."""

    left_m: Array
    right_m: Array
    found: npt.NDArray[np.bool_]

    @property
    def width_m(self) -> Array:
        return self.right_m - self.left_m

    @property
    def middle_m(self) -> Array:
        return (self.left_m + self.right_m) / 2


def touch_of(left: Rays, right: Rays) -> Touch:
    """Return the first touch of the pads, from the contacts (n, 7) of the rays on either side."""
    found = np.asarray(np.isfinite(left).any(axis=1))
    first = np.where(found, left.min(axis=1) + np.float32(_INSET_M), 0.0)
    last = np.where(found, right.max(axis=1) - np.float32(_INSET_M), 0.0)
    return Touch(first.astype(float), last.astype(float), found)


def touching(contacts: Rays, touch_m: Array) -> npt.NDArray[np.bool_]:
    """Return which rays (n, 7) touch, too, where the pad touches first."""
    return np.asarray(np.abs(contacts - touch_m[:, None]) < _NEAR_PATCH_M)


class Profile:
    """Heights along the closing axis of n candidates: 7 rays across the finger, 1 mm steps."""

    def __init__(self, heights: HeightMap, centers_m: Array, axis: Array, hand: HandSettings) -> None:
        reach_m = hand.max_width_m / 2 + hand.finger_thickness_m + _REACH_BEYOND_M
        self.t_m = np.arange(-reach_m, reach_m + _STEP_M / 2, _STEP_M).astype(np.float32)
        lateral = np.stack([-axis[:, 1], axis[:, 0]], axis=1)
        x, y = (
            centers_m[:, k, None, None].astype(np.float32)
            + axis[:, k, None, None].astype(np.float32) * self.t_m[None, None, :]
            + lateral[:, k, None, None].astype(np.float32) * RAYS_M[None, :, None]
            for k in (0, 1)
        )
        self._cells = heights.cells(x, y)
        self._maps = heights.framed
        self.heights_m = self._maps.surface_m.take(self._cells)
        self._bound_m = self._maps.bound_m.take(self._cells).max(axis=1)
        self._beside_m = self._maps.beside_m.take(self._cells).max(axis=1)
        self._finger_m, self._jaw_m = hand.finger_thickness_m, hand.max_width_m

    def _within(self, half_m: float) -> tuple[Rays, Rays]:
        """Places (k,) along the closing axis at most so far from the middle, and the heights (n, 7, k) there."""
        inside = np.flatnonzero(np.abs(self.t_m) <= half_m)
        part = np.s_[inside[0] : inside[-1] + 1]
        return self.t_m[part], self.heights_m[..., part]

    def contacts(self, slice_m: Array, half_m: float) -> tuple[Rays, Rays]:
        """Position (n, 7) where each ray first meets material from the left and from the right; +-inf for none."""
        t_m, heights_m = self._within(half_m)
        solid = heights_m > slice_m[:, None, None].astype(np.float32)
        first = solid.argmax(axis=2)
        hit = np.take_along_axis(solid, first[..., None], axis=2)[..., 0]
        half_step = np.float32(_STEP_M / 2)
        left = np.where(hit, t_m[first] - half_step, np.float32(np.inf))
        right = np.where(hit, t_m[::-1][solid[..., ::-1].argmax(axis=2)] + half_step, np.float32(-np.inf))
        return left, right

    def edge_m(self, contact: Rays, touch_m: Array, inward: float) -> Array:
        """Median height (n,) of the surface 1 to 2.5 mm inside the contacts of the touching rays."""
        near = touching(contact, touch_m)
        values = [self._at(np.where(near, contact, 0) + np.float32(inward * (d + _STEP_M / 2))) for d in _INSIDE_M]
        height = np.maximum(*values)
        return np.nan_to_num(_median(np.where(near, height, np.nan)))

    def across_rad(self, contact: Rays, touch_m: Array) -> Array:
        """Angle (n,) across the pad between the closing axis and the face's normal."""
        near = touching(contact, touch_m)
        return np.asarray(np.arctan(np.abs(_slope(np.broadcast_to(RAYS_M, contact.shape), contact, near))))

    def face_rad(self, contact: Rays, touch_m: Array) -> Array:
        """As `across_rad`, of a face that goes on by one ray to either side of those that touch."""
        near = touching(contact, touch_m)
        wider = near.copy()
        wider[:, 1:] |= near[:, :-1]
        wider[:, :-1] |= near[:, 1:]
        wider &= np.abs(contact - touch_m[:, None]) < _FACE_M
        return np.asarray(np.arctan(np.abs(_slope(np.broadcast_to(RAYS_M, contact.shape), contact, wider))))

    def contacts_above(self, tip_m: Array) -> list[tuple[Rays, Rays]]:
        """The contacts at each higher level, wherever along the axis."""
        return [self.contacts(tip_m + level_m, float(self.t_m[-1])) for level_m in LEVELS_M[1:]]

    def up_rad(self, above: list[Rays], contact: Rays, touch_m: Array, inward: float) -> Array:
        """Angle (n,) by which the face leans back; ``above``: this side's contacts (n, 7) at each higher level."""
        near = touching(contact, touch_m)
        slope = np.zeros(len(touch_m))
        for level_m, higher in zip(LEVELS_M[1:], above, strict=True):
            is_there = near & np.isfinite(higher)
            back = (np.where(is_there, higher, 0) - np.where(is_there, contact, 0)) * np.float32(inward)
            back_m = _median(np.where(is_there, back, np.nan))
            steep = np.nan_to_num(back_m / float(level_m - LEVELS_M[0]))
            slope = np.maximum(slope, np.where(back_m < _ANOTHER_M, steep, 0.0))
        return np.asarray(np.arctan(np.maximum(slope - _BLUNT, 0.0)))

    def tilt_rad(self, left_m: Array, right_m: Array) -> Array:
        """Angle (n,) of the surface between the contacts along the closing axis; 0 where they are too near."""
        t_m, heights_m = self._within(self._jaw_m / 2)
        between = (t_m > left_m[:, None] + 0.003) & (t_m < right_m[:, None] - 0.003)
        middle = np.broadcast_to(t_m, between.shape), _middle_of_rays(heights_m)
        return np.asarray(np.arctan(np.abs(_slope(*middle, between))))

    def solid(self, left_m: Array, right_m: Array, edge_m: Array) -> Array:
        """1 where the surface between the contacts has no valley below the edge, 0 from a deep one on; (n,)."""
        t_m, heights_m = self._within(self._jaw_m / 2)
        between = (t_m >= left_m[:, None] + 0.002) & (t_m <= right_m[:, None] - 0.002)
        middle = heights_m[:, 1:-1].max(axis=1)
        low_m = np.where(between, middle, np.float32(np.inf)).min(axis=1)
        depth_m = np.where(between.any(axis=1), edge_m - low_m, 0.0)
        return np.asarray(1 - np.clip((depth_m - _VALLEY_M[0]) / (_VALLEY_M[1] - _VALLEY_M[0]), 0, 1))

    def between(self, left_m: Array, right_m: Array) -> tuple[Labels, Labels, Labels]:
        """Thing, piece and colour patch (n, 3) inside the left contact, in the middle, and inside the right one."""
        inset_m = np.minimum(0.0025, (right_m - left_m) / 2)
        places = np.stack([left_m + inset_m, (left_m + right_m) / 2, right_m - inset_m], axis=1)
        index = self._index(places.astype(np.float32))
        cells = np.take_along_axis(self._cells, index[:, None, :], axis=2)  # (n, 7, 3)
        maps = self._maps
        things, parts, patches = (_mode(one.take(cells)) for one in (maps.labels, maps.pieces, maps.patches))
        return things, parts, patches

    def under_fingers_m(self, middle_m: Array, opening_m: Array, width_m: Array) -> Array:
        """Height (n,) of the highest that may be occupied below either opened finger.

        What is not the held object itself must also be clear of the finger to the side.
        """
        out = np.abs(self.t_m[None, :] - middle_m[:, None])
        inner, outer = opening_m[:, None] / 2, opening_m[:, None] / 2 + self._finger_m
        under = (out >= inner) & (out <= outer)
        beside = (out >= np.maximum(inner, width_m[:, None] / 2 + _OWN_M)) & (out <= outer + _BESIDE_M)
        highest = np.maximum(np.where(under, self._bound_m, 0), np.where(beside, self._beside_m, 0))
        return np.asarray(highest.max(axis=1), dtype=float)

    def _index(self, position_m: Rays) -> npt.NDArray[np.int32]:
        index = np.rint((position_m - self.t_m[0]) / np.float32(_STEP_M)).astype(np.int32)
        return np.asarray(index.clip(0, len(self.t_m) - 1))

    def _at(self, position_m: Rays) -> Rays:
        return np.asarray(np.take_along_axis(self.heights_m, self._index(position_m)[..., None], axis=2)[..., 0])


def _mode(labels: npt.NDArray[np.int16]) -> npt.NDArray[np.int16]:
    """The middle one (n, 3) of the nonzero labels (n, 7, 3), which is the most frequent when one prevails."""
    ordered = np.sort(labels, axis=1)
    zeros = (ordered == 0).sum(axis=1)
    at = np.minimum((zeros + labels.shape[1]) // 2, labels.shape[1] - 1)
    return np.asarray(np.take_along_axis(ordered, at[:, None], axis=1)[:, 0])


def _middle_of_rays(values: Rays) -> Rays:
    """The middle one (n, k) of the values (n, 7, k) over the rays, in size."""
    return np.partition(values, values.shape[1] // 2, axis=1)[:, values.shape[1] // 2]


def _slope(x: Rays, y: Rays, used: npt.NDArray[np.bool_]) -> Array:
    """Slope (n,) of a line through the used points (n, k); 0 with fewer than two."""
    weight = used.astype(float)
    total = np.maximum(weight.sum(axis=1, keepdims=True), 1e-9)
    dx = np.where(used, x - (weight * x).sum(axis=1, keepdims=True) / total, 0.0)
    values = np.where(used, y, 0.0)
    dy = np.where(used, y - values.sum(axis=1, keepdims=True) / total, 0.0)
    return np.asarray((dx * dy).sum(axis=1) / np.maximum((dx * dx).sum(axis=1), 1e-12))


def _median(values: npt.NDArray[np.floating]) -> Array:
    """Median along the last axis, ignoring NaN; NaN for all-NaN rows, without numpy's warning."""
    ordered = np.sort(values, axis=-1)  # NaN last
    count = np.isfinite(values).sum(axis=-1)
    middle = np.maximum(count - 1, 0) // 2
    return np.asarray(np.take_along_axis(ordered, middle[:, None], axis=-1)[:, 0], dtype=float)
