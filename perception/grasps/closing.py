"""Closes the jaw on candidates over a height map: where the pads touch, whether it is free, how good it is.

All in the map's level frame (docs/frames.md): a candidate is a centre (x, y), the heading of the closing axis, and the
height of the finger tips. The surface gives what the pads touch, the bound what fingers and palm must not enter.
Lengths in metres, angles in radians.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from config.devices import HandSettings
from config.franka_hand import FINGER_TIP_M, PALM_ABOVE_TIP_M
from config.schema import Station
from perception.scene.heightmap import HeightMap, Labels

TABLE_CLEARANCE_M = 0.003
"""Least height of the finger tips above the seen table."""
HOLD_M = 0.022
"""Largest depth of the finger tips below the visible edge: deeper, hidden overhangs meet the finger's face first."""
_MIN_HOLD_M = 0.003
OVER_M = 0.004
"""Clearance of finger tips and palm above what may be occupied below them."""
_OWN_M, _BESIDE_M = 0.005, 0.002
"""So near to a contact is the held object, whose face the finger may nearly touch; other things keep so far beside."""
_LEVELS_M = np.array([0.0015, 0.006, 0.012, 0.018], dtype=np.float32)
"""Heights above the finger tips at which contacts are looked for."""
_RAYS_M = np.linspace(-0.009, 0.009, 7, dtype=np.float32)
_STEP_M = 0.001
_REACH_BEYOND_M = 0.014
_NEAR_PATCH_M = 0.003
_FACE_M = 0.006
"""So far behind the first contact the face goes on: two rays alone, where a pad's edge meets a round one, are level."""
_MAX_FACE_RAD = float(np.deg2rad(32))
"""Largest angle across the pad so far behind the contact: a round face leans more there than where it is touched."""
_MIN_SLACK_M = 0.001
_INSET_M = 0.0005
"""How much too wide each side reads: a cell is as high as its highest point, so faces seem half a cell farther out."""
_INSIDE_M = (0.001, 0.0025)
"""The edge is the surface so far inside a contact."""
MAX_ANGLE_RAD = float(np.deg2rad(24))
"""Largest angle between the closing axis and a face: friction 0.5 holds 26.6 degrees."""
_FRICTION_RAD = float(np.arctan(0.5))
_VALLEY_M = (0.002, 0.010)
_WIDE_M, _ROOM_M = 0.060, 0.010
_ANOTHER_M, _BLUNT = 0.012, 0.1
"""A face that lies so much farther back is another one; a slope as small as depth noise makes at a rim is none."""
_PALM = np.stack(np.meshgrid(np.linspace(-0.10, 0.10, 21), np.linspace(-0.032, 0.032, 7)), axis=-1).reshape(-1, 2)
_CHUNK = 200

Array = npt.NDArray[np.float64]
Rays = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Closings:
    """The result of closing the jaw on n candidates; arrays of length n.

    Attributes:
        center_m: (n, 2) midpoint of the contacts. ``heading_rad``: of the closing axis.
        tcp_m: height of the tcp in the level frame.
        edge_m: height of the surface just inside the contacts, the lower side.
        width_m: distance between the contacts. ``opening_m``: hand width for the approach.
        instance: number of the thing between the contacts; 0 = none, or two of them.
        lean: by how much one face leans back more than the other, 1 = as much as friction holds.
        terms: criteria, each between 0 and 1. ``score``: their weighted mean, -inf = not feasible.
    """

    center_m: Array
    heading_rad: Array
    tcp_m: Array
    edge_m: Array
    width_m: Array
    opening_m: Array
    instance: npt.NDArray[np.int16]
    lean: Array
    terms: dict[str, Array]
    score: Array

    @property
    def slice_m(self) -> Array:
        """(n,) the height at which the pads touch first: just above the finger tips."""
        return np.asarray(self.tcp_m - FINGER_TIP_M + float(_LEVELS_M[0]))

    def distinct(self, most: int, apart_m: float = 0.006, apart_rad: float = float(np.deg2rad(10))) -> list[int]:
        """Indices of the best feasible candidates, the best first, at most ``most`` of them.

        Args:
            apart_m, apart_rad: least difference in place or heading between any two.
        """
        chosen: list[int] = []
        for index in np.argsort(-self.score, kind="stable"):
            if len(chosen) == most or not np.isfinite(self.score[index]):
                break
            moved_m = np.linalg.norm(self.center_m[chosen] - self.center_m[index], axis=1)
            turned = np.abs((self.heading_rad[chosen] - self.heading_rad[index] + np.pi / 2) % np.pi - np.pi / 2)
            if ((moved_m > apart_m) | (turned > apart_rad)).all():
                chosen.append(int(index))
        return chosen

    def on(self, instance: int) -> Closings:
        """Return the feasible ones on one thing, in their order."""
        return self.taken(np.flatnonzero((self.instance == instance) & np.isfinite(self.score)))

    def taken(self, chosen: npt.NDArray[np.integer] | npt.NDArray[np.bool_] | list[int]) -> Closings:
        """Return the chosen ones, in their order."""
        terms = {name: values[chosen] for name, values in self.terms.items()}
        rest = {one.name: getattr(self, one.name)[chosen] for one in fields(self) if one.name != "terms"}
        return Closings(terms=terms, **rest)


WEIGHTS = {
    "wide": 3.2,
    "free": 1.6,
    "patch": 1.3,
    "upright": 1.2,
    "one": 1.0,
    "robust": 0.9,
    "square": 0.9,
    "solid": 0.8,
    "room": 0.6,
    "level": 0.5,
    "central": 0.8,
}
"""Weights of the criteria, fitted (logistic regression, no negative weights) to whether 9,382 grasps in 150 simulated
heaps hold on the true shapes, the development seeds of `benchmarks scenes`. In their order: not narrow; room beside the
fingers; long contact patches; the surface between the pads level along the closing axis; one piece and one colour
there; the share of small pose errors after which the jaw still closes; faces square to the closing axis; no valley
between the pads; room in the jaw; both edges equally high. Not fitted: not far beside the thing's middle, so that its
weight hardly turns it in the jaw."""


def weighted(terms: dict[str, Array], weights: dict[str, float] = WEIGHTS) -> Array:
    """Return the weighted mean (n,) of named criteria, each (n,) from 0 to 1; those without a weight do not count."""
    used = [name for name in terms if name in weights]
    return np.asarray(sum(weights[name] * terms[name] for name in used) / sum(weights[name] for name in used))


def close(
    heights: HeightMap,
    centers_m: Array,
    headings_rad: Array,
    slices_m: Array,
    station: Station,
    *,
    clearance_m: float | None = None,
) -> Closings:
    """Close the jaw on candidates.

    Args:
        centers_m: (n, 2). ``headings_rad``: (n,) of the closing axis. ``slices_m``: (n,) height at which the material
            between the fingers is looked for first.
        clearance_m: free room of each opened finger; None = the station's ``approach_clearance_m``.
    """
    room_m = station.perception.approach_clearance_m if clearance_m is None else clearance_m
    parts = [
        _closed(heights, centers_m[at], headings_rad[at], slices_m[at], station, room_m)
        for at in (slice(start, start + _CHUNK) for start in range(0, max(len(centers_m), 1), _CHUNK))
    ]
    return joined(parts)


def joined(parts: list[Closings]) -> Closings:
    """Several closings as one, in their order."""
    if len(parts) == 1:
        return parts[0]
    terms = {name: np.concatenate([part.terms[name] for part in parts]) for name in parts[0].terms}
    rest = {
        one.name: np.concatenate([getattr(part, one.name) for part in parts])
        for one in fields(Closings)
        if one.name != "terms"
    }
    return Closings(terms=terms, **rest)


def _closed(
    heights: HeightMap, centers_m: Array, headings_rad: Array, slices_m: Array, station: Station, room_m: float
) -> Closings:
    hand = station.hand
    axis = np.stack([np.cos(headings_rad), np.sin(headings_rad)], axis=1)
    profile = _Profile(heights, centers_m, axis, hand)
    half_m = hand.max_width_m / 2
    left, right = profile.contacts(slices_m, half_m)
    touch = _touch(left, right)
    tip_m = slices_m - _LEVELS_M[0]
    for _ in range(2):
        opening_m = np.minimum(hand.max_width_m, touch.width_m + 2 * room_m)
        palm_m = _palm_top(heights, centers_m + axis * touch.middle_m[:, None], axis) - PALM_ABOVE_TIP_M
        under_m = profile.under_fingers_m(touch.middle_m, opening_m, touch.width_m)
        edge_m = np.minimum(profile.edge_m(left, touch.left_m, 1.0), profile.edge_m(right, touch.right_m, -1.0))
        lowest_m = np.maximum(np.maximum(under_m, palm_m) + OVER_M, TABLE_CLEARANCE_M)
        tip_m = np.maximum(lowest_m, edge_m - HOLD_M)
        left, right = profile.contacts(tip_m + _LEVELS_M[0], half_m)
        touch = _touch(left, right)
    opening_m = np.minimum(hand.max_width_m, touch.width_m + 2 * room_m)
    left_edge_m, right_edge_m = profile.edge_m(left, touch.left_m, 1.0), profile.edge_m(right, touch.right_m, -1.0)
    edge_m = np.minimum(left_edge_m, right_edge_m)
    feasible = (
        touch.found
        & (touch.width_m > hand.min_width_m)
        & (opening_m - touch.width_m >= 2 * _MIN_SLACK_M - 1e-6)
        & (np.abs(touch.middle_m) < 0.02)
        & (tip_m < edge_m - _MIN_HOLD_M)
        & (profile.under_fingers_m(touch.middle_m, opening_m, touch.width_m) < tip_m - 0.001)
    )
    patch = (_near(left, touch.left_m) & _near(right, touch.right_m)).mean(axis=1)
    lean = np.arctan(np.abs(left_edge_m - right_edge_m) / np.maximum(touch.width_m, 0.005))
    across = np.maximum(profile.across_rad(left, touch.left_m), profile.across_rad(right, touch.right_m))
    face = np.maximum(profile.face_rad(left, touch.left_m), profile.face_rad(right, touch.right_m))
    above = profile.contacts_above(tip_m)
    left_up = profile.up_rad([one for one, _ in above], left, touch.left_m, 1.0)
    right_up = profile.up_rad([other for _, other in above], right, touch.right_m, -1.0)
    angle = np.hypot(across, np.maximum(left_up, right_up))
    labels, parts, patches = profile.between(touch.left_m, touch.right_m)
    solid = profile.solid(touch.left_m, touch.right_m, edge_m)
    instance = _held(labels, parts[:, 0] == parts[:, 2], (solid >= 1) & _same(patches))
    feasible &= (angle < MAX_ANGLE_RAD) & (face < _MAX_FACE_RAD) & (patch > 1.5 / len(_RAYS_M)) & (instance > 0)
    center_m = centers_m + axis * touch.middle_m[:, None]
    terms = {
        "square": np.clip(1 - across / _FRICTION_RAD, 0, 1),
        "patch": patch,
        "level": np.clip(1 - lean / _FRICTION_RAD, 0, 1),
        "upright": np.clip(1 - profile.tilt_rad(touch.left_m, touch.right_m) / _FRICTION_RAD, 0, 1),
        "wide": np.clip(touch.width_m / _WIDE_M, 0, 1),
        "room": np.clip((hand.max_width_m - touch.width_m) / _ROOM_M, 0, 1),
        "free": np.clip((opening_m - touch.width_m) / (2 * room_m + 1e-9), 0, 1),
        "solid": solid,
        "one": (_same(parts).astype(float) + _same(patches)) / 2,
        "central": _central(heights, center_m, instance),
    }
    score = np.where(feasible, weighted(terms), -np.inf)
    return Closings(
        center_m,
        headings_rad,
        tip_m + FINGER_TIP_M,
        edge_m,
        touch.width_m,
        opening_m,
        instance,
        np.minimum(np.abs(left_up - right_up) / _FRICTION_RAD, 1),
        terms,
        score,
    )


@dataclass(frozen=True)
class _Touch:
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


def _touch(left: Rays, right: Rays) -> _Touch:
    found = np.asarray(np.isfinite(left).any(axis=1))
    first = np.where(found, left.min(axis=1) + np.float32(_INSET_M), 0.0)
    last = np.where(found, right.max(axis=1) - np.float32(_INSET_M), 0.0)
    return _Touch(first.astype(float), last.astype(float), found)


def _near(contacts: Rays, touch_m: Array) -> npt.NDArray[np.bool_]:
    return np.asarray(np.abs(contacts - touch_m[:, None]) < _NEAR_PATCH_M)


def _held(labels: Labels, same_piece: npt.NDArray[np.bool_], is_even: npt.NDArray[np.bool_]) -> Labels:
    """The number (n,) of the thing between the contacts; 0 = two things, or two pieces that may be two.

    Args:
        labels: (n, 3) things at the left contact, in the middle and at the right contact.
        same_piece: (n,) both contacts are on one piece. ``is_even``: (n,) neither a valley nor another colour between.
    """
    one_thing = (labels[:, 0] == labels[:, 2]) & (same_piece | is_even)
    return np.where(one_thing, labels[:, 0], 0).astype(np.int16)


def _central(heights: HeightMap, center_m: Array, instance: Labels) -> Array:
    """1 over or under the middle of the thing, 0 from two rms radii beside it on; (n,).

    Its weight turns it in the jaw by how far it is held beside its middle, not by how high.
    """
    middle_m, radius_m = heights.middles
    beside_m = center_m - middle_m[instance]
    beside_m -= (beside_m @ heights.up_xy)[:, None] * heights.up_xy
    off_m = np.linalg.norm(beside_m, axis=1)
    return np.asarray(1 - np.minimum(off_m / np.maximum(radius_m[instance], 0.01), 2) / 2)


def _same(labels: npt.NDArray[np.int16]) -> npt.NDArray[np.bool_]:
    return np.asarray((labels[:, 0] == labels[:, 2]) & (labels[:, 0] == labels[:, 1]))


class _Profile:
    """Heights along the closing axis of n candidates: 7 rays across the finger, 1 mm steps."""

    def __init__(self, heights: HeightMap, centers_m: Array, axis: Array, hand: HandSettings) -> None:
        reach_m = hand.max_width_m / 2 + hand.finger_thickness_m + _REACH_BEYOND_M
        self.t_m = np.arange(-reach_m, reach_m + _STEP_M / 2, _STEP_M).astype(np.float32)
        lateral = np.stack([-axis[:, 1], axis[:, 0]], axis=1)
        x, y = (
            centers_m[:, k, None, None].astype(np.float32)
            + axis[:, k, None, None].astype(np.float32) * self.t_m[None, None, :]
            + lateral[:, k, None, None].astype(np.float32) * _RAYS_M[None, :, None]
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
        near = _near(contact, touch_m)
        values = [self._at(np.where(near, contact, 0) + np.float32(inward * (d + _STEP_M / 2))) for d in _INSIDE_M]
        height = np.maximum(*values)
        return np.nan_to_num(_median(np.where(near, height, np.nan)))

    def across_rad(self, contact: Rays, touch_m: Array) -> Array:
        """Angle (n,) across the pad between the closing axis and the face's normal."""
        near = _near(contact, touch_m)
        return np.asarray(np.arctan(np.abs(_slope(np.broadcast_to(_RAYS_M, contact.shape), contact, near))))

    def face_rad(self, contact: Rays, touch_m: Array) -> Array:
        """As `across_rad`, of a face that goes on by one ray to either side of those that touch."""
        near = _near(contact, touch_m)
        wider = near.copy()
        wider[:, 1:] |= near[:, :-1]
        wider[:, :-1] |= near[:, 1:]
        wider &= np.abs(contact - touch_m[:, None]) < _FACE_M
        return np.asarray(np.arctan(np.abs(_slope(np.broadcast_to(_RAYS_M, contact.shape), contact, wider))))

    def contacts_above(self, tip_m: Array) -> list[tuple[Rays, Rays]]:
        """The contacts at each higher level, wherever along the axis."""
        return [self.contacts(tip_m + level_m, float(self.t_m[-1])) for level_m in _LEVELS_M[1:]]

    def up_rad(self, above: list[Rays], contact: Rays, touch_m: Array, inward: float) -> Array:
        """Angle (n,) by which the face leans back; ``above``: this side's contacts (n, 7) at each higher level."""
        near = _near(contact, touch_m)
        slope = np.zeros(len(touch_m))
        for level_m, higher in zip(_LEVELS_M[1:], above, strict=True):
            is_there = near & np.isfinite(higher)
            back = (np.where(is_there, higher, 0) - np.where(is_there, contact, 0)) * np.float32(inward)
            back_m = _median(np.where(is_there, back, np.nan))
            steep = np.nan_to_num(back_m / float(level_m - _LEVELS_M[0]))
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


def _palm_top(heights: HeightMap, centers_m: Array, axis: Array) -> Array:
    """The highest (n,) that may be occupied below the palm."""
    x, y = centers_m.T[..., None].astype(np.float32)
    c, s = axis.T[..., None].astype(np.float32)
    along, across = _PALM.T.astype(np.float32)
    cells = heights.cells(x + c * along - s * across, y + s * along + c * across)
    return np.asarray(heights.framed.around_m.take(cells).max(axis=1), dtype=float)
