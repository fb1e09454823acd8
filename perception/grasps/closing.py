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
from perception.grasps.profile import LEVELS_M, RAYS_M, Array, Profile, Rays, Touch, touch_of, touching
from perception.scene.heightmap import HeightMap, Labels

TABLE_CLEARANCE_M = 0.003
"""Least height of the finger tips above the seen table."""
HOLD_M = 0.022
"""Largest depth of the finger tips below the visible edge: deeper, hidden overhangs meet the finger's face first."""
_MIN_HOLD_M = 0.003
OVER_M = 0.004
"""Clearance of finger tips and palm above what may be occupied below them."""
_MAX_FACE_RAD = float(np.deg2rad(32))
"""Largest angle across the pad so far behind the contact: a round face leans more there than where it is touched."""
_MIN_SLACK_M = 0.001
MAX_ANGLE_RAD = float(np.deg2rad(24))
"""Largest angle between the closing axis and a face: friction 0.5 holds 26.6 degrees."""
_FRICTION_RAD = float(np.arctan(0.5))
_WIDE_M, _ROOM_M = 0.060, 0.010
_PALM = np.stack(np.meshgrid(np.linspace(-0.10, 0.10, 21), np.linspace(-0.032, 0.032, 7)), axis=-1).reshape(-1, 2)
_CHUNK = 200
MORE_ROOM_M, _DEEPER_M = (0.010, 0.014, 0.018, 0.022, 0.026), 0.002
"""In an image taken aslant: rooms beside each finger that are tried, and how much deeper one must let it come down. The
back of a thing hides what is low behind it; farther away from it, lower places are seen to be free."""
_SHALLOW = 0.5
"""In an image taken aslant: of a grasp less deep than this share the whole score falls, at no depth to so much."""


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
        return np.asarray(self.tcp_m - FINGER_TIP_M + float(LEVELS_M[0]))

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
    "deep": 2.0,
}
"""Weights of the criteria, fitted (logistic regression, no negative weights) to whether 9,382 grasps in 150 simulated
heaps hold on the true shapes, the development seeds of `benchmarks scenes`. In their order: not narrow; room beside the
fingers; long contact patches; the surface between the pads level along the closing axis; one piece and one colour
there; the share of small pose errors after which the jaw still closes; faces square to the closing axis; no valley
between the pads; room in the jaw; both edges equally high. Not fitted: not far beside the thing's middle, so that its
weight hardly turns it in the jaw; of an image taken aslant, deep."""


def weighted(terms: dict[str, Array], weights: dict[str, float] = WEIGHTS) -> Array:
    """Return the weighted mean (n,) of named criteria, each (n,) from 0 to 1; those without a weight do not count.

    What is not deep at all holds nothing, whatever else it has: it scores less than the mean.
    """
    used = [name for name in terms if name in weights]
    mean = np.asarray(sum(weights[name] * terms[name] for name in used) / sum(weights[name] for name in used))
    return mean * np.minimum(1.0, _SHALLOW + terms["deep"]) if "deep" in terms else mean


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
    profile = Profile(heights, centers_m, axis, hand)
    jaw = _lowered(heights, profile, centers_m, axis, slices_m, room_m, hand)
    faces, touch = _faces(profile, jaw), jaw.touch
    labels, parts, patches = profile.between(touch.left_m, touch.right_m)
    solid = profile.solid(touch.left_m, touch.right_m, jaw.edge_m)
    instance = _held(labels, parts[:, 0] == parts[:, 2], (solid >= 1) & _same(patches))
    center_m = centers_m + axis * touch.middle_m[:, None]
    terms = {
        "square": np.clip(1 - faces.across_rad / _FRICTION_RAD, 0, 1),
        "patch": faces.patch,
        "level": np.clip(1 - jaw.slope_rad / _FRICTION_RAD, 0, 1),
        "upright": np.clip(1 - profile.tilt_rad(touch.left_m, touch.right_m) / _FRICTION_RAD, 0, 1),
        "wide": np.clip(touch.width_m / _WIDE_M, 0, 1),
        "room": np.clip((hand.max_width_m - touch.width_m) / _ROOM_M, 0, 1),
        "free": np.clip((jaw.opening_m - touch.width_m) / (2 * room_m + 1e-9), 0, 1),
        "solid": solid,
        "one": (_same(parts).astype(float) + _same(patches)) / 2,
        "central": _central(heights, center_m, instance),
    }
    if heights.is_aslant:
        terms["deep"] = _deep(jaw.edge_m, jaw.tip_m)
    feasible = _fits(profile, jaw, hand) & faces.hold & (instance > 0)
    return Closings(
        center_m,
        headings_rad,
        jaw.tip_m + FINGER_TIP_M,
        jaw.edge_m,
        touch.width_m,
        jaw.opening_m,
        instance,
        faces.lean,
        terms,
        np.where(feasible, weighted(terms), -np.inf),
    )


@dataclass(frozen=True)
class _Jaw:
    """The jaw as deep as it may come down, on n candidates.

    Attributes:
        left, right: (n, 7) contacts of the rays. ``touch``: of the pads.
        tip_m: (n,) height of the finger tips. ``opening_m``: (n,) width of the hand that comes down.
        left_edge_m, right_edge_m: (n,) height of the surface just inside the contacts.
    """

    left: Rays
    right: Rays
    touch: Touch
    tip_m: Array
    opening_m: Array
    left_edge_m: Array
    right_edge_m: Array

    @property
    def edge_m(self) -> Array:
        """(n,) the lower edge."""
        return np.minimum(self.left_edge_m, self.right_edge_m)

    @property
    def slope_rad(self) -> Array:
        """(n,) from one edge to the other."""
        rise_m = np.abs(self.left_edge_m - self.right_edge_m)
        return np.asarray(np.arctan(rise_m / np.maximum(self.touch.width_m, 0.005)))


def _lowered(
    heights: HeightMap,
    profile: Profile,
    centers_m: Array,
    axis: Array,
    slices_m: Array,
    room_m: float,
    hand: HandSettings,
) -> _Jaw:
    """Lower the jaw until fingers or palm would meet something, or the pads hold enough; twice, as contacts change."""

    def closed(slice_m: Array, tip_m: Array) -> _Jaw:
        left, right = profile.contacts(slice_m, hand.max_width_m / 2)
        touch = touch_of(left, right)
        opening_m = _opening(profile, touch, room_m, hand, heights.is_aslant)
        left_edge_m, right_edge_m = profile.edge_m(left, touch.left_m, 1.0), profile.edge_m(right, touch.right_m, -1.0)
        return _Jaw(left, right, touch, tip_m, opening_m, left_edge_m, right_edge_m)

    jaw = closed(slices_m, slices_m - LEVELS_M[0])
    for _ in range(2):
        touch = jaw.touch
        palm_m = _palm_top(heights, centers_m + axis * touch.middle_m[:, None], axis) - PALM_ABOVE_TIP_M
        under_m = profile.under_fingers_m(touch.middle_m, jaw.opening_m, touch.width_m)
        lowest_m = np.maximum(np.maximum(under_m, palm_m) + OVER_M, TABLE_CLEARANCE_M)
        tip_m = np.maximum(lowest_m, jaw.edge_m - HOLD_M)
        jaw = closed(tip_m + LEVELS_M[0], tip_m)
    return jaw


def _fits(profile: Profile, jaw: _Jaw, hand: HandSettings) -> npt.NDArray[np.bool_]:
    """Whether (n,) the opened hand comes around what it touches, and deep enough, without meeting anything."""
    touch = jaw.touch
    return np.asarray(
        touch.found
        & (touch.width_m > hand.min_width_m)
        & (jaw.opening_m - touch.width_m >= 2 * _MIN_SLACK_M - 1e-6)
        & (np.abs(touch.middle_m) < 0.02)
        & (jaw.tip_m < jaw.edge_m - _MIN_HOLD_M)
        & (profile.under_fingers_m(touch.middle_m, jaw.opening_m, touch.width_m) < jaw.tip_m - 0.001)
    )


@dataclass(frozen=True)
class _Faces:
    """The two faces that the pads touch (n,), the worse of them.

    Attributes:
        across_rad: angle across the pad between the closing axis and the normal; ``round_rad``: of the face farther on.
        angle_rad: the same with how far a face leans back. ``lean``: as of `Closings`.
        patch: share of the rays that touch, of both.
    """

    across_rad: Array
    round_rad: Array
    angle_rad: Array
    lean: Array
    patch: Array

    @property
    def hold(self) -> npt.NDArray[np.bool_]:
        """(n,) whether the pads do not slide off them."""
        is_square = (self.angle_rad < MAX_ANGLE_RAD) & (self.round_rad < _MAX_FACE_RAD)
        return np.asarray(is_square & (self.patch > 1.5 / len(RAYS_M)))


def _faces(profile: Profile, jaw: _Jaw) -> _Faces:
    (left, left_m), (right, right_m) = (jaw.left, jaw.touch.left_m), (jaw.right, jaw.touch.right_m)
    across = np.maximum(profile.across_rad(left, left_m), profile.across_rad(right, right_m))
    above = profile.contacts_above(jaw.tip_m)
    left_up = profile.up_rad([one for one, _ in above], left, left_m, 1.0)
    right_up = profile.up_rad([other for _, other in above], right, right_m, -1.0)
    return _Faces(
        across,
        np.maximum(profile.face_rad(left, left_m), profile.face_rad(right, right_m)),
        np.hypot(across, np.maximum(left_up, right_up)),
        np.minimum(np.abs(left_up - right_up) / _FRICTION_RAD, 1),
        (touching(left, left_m) & touching(right, right_m)).mean(axis=1),
    )


def _opening(profile: Profile, touch: Touch, room_m: float, hand: HandSettings, is_aslant: bool) -> Array:
    """The hand's width (n,) to come with; in an image taken aslant wider, where the fingers then come down deeper."""
    opening_m = np.minimum(hand.max_width_m, touch.width_m + 2 * room_m)
    if not is_aslant:
        return opening_m
    under_m = profile.under_fingers_m(touch.middle_m, opening_m, touch.width_m)
    for more_m in MORE_ROOM_M:
        wider_m = np.minimum(hand.max_width_m, touch.width_m + 2 * more_m)
        lower_m = profile.under_fingers_m(touch.middle_m, wider_m, touch.width_m)
        is_deeper = lower_m < under_m - _DEEPER_M
        opening_m, under_m = np.where(is_deeper, wider_m, opening_m), np.where(is_deeper, lower_m, under_m)
    return opening_m


def _deep(edge_m: Array, tip_m: Array) -> Array:
    """The depth (n,) of the finger tips below the edge, as a share of what the pads, or the table, let them have."""
    most_m = np.minimum(HOLD_M, np.maximum(edge_m - TABLE_CLEARANCE_M, _MIN_HOLD_M))
    return np.clip((edge_m - tip_m) / most_m, 0, 1)


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


def _palm_top(heights: HeightMap, centers_m: Array, axis: Array) -> Array:
    """The highest (n,) that may be occupied below the palm."""
    x, y = centers_m.T[..., None].astype(np.float32)
    c, s = axis.T[..., None].astype(np.float32)
    along, across = _PALM.T.astype(np.float32)
    cells = heights.cells(x + c * along - s * across, y + s * along + c * across)
    return np.asarray(heights.framed.around_m.take(cells).max(axis=1), dtype=float)
