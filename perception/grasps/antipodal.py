"""Top-down antipodal grasps on a height map: candidates from contour pairs, evaluated by closing the jaw on them.

All in ``base`` (docs/frames.md): a candidate is a centre (x, y), the heading of the closing axis, and the height of the
tcp above the table. Lengths in metres, angles in radians.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from config.franka_hand import FINGER_TIP_M, PALM_ABOVE_TIP_M
from config.schema import HandSettings, Station
from perception.scene.heightmap import CELL_M, HeightMap

TABLE_CLEARANCE_M = 0.004
_HOLD_M = 0.012
"""Depth of the tcp below the visible edge: the pads (18 mm) then lie on the side, not below a round object's widest
part."""

_MIN_CONTACT_M = 0.003
"""Least height of the side that the pads touch; flat objects are held by the finger ends."""
_MIN_SLACK_M = 0.004

_SLICES = (0.35, 0.6, 0.85)
_CONTOUR_POINTS = 220
_CANDIDATES = 80
_FRICTION_COS = float(np.cos(np.arctan(0.5)))
_STEP_M = 0.001
_RAYS = np.linspace(-0.009, 0.009, 7)
_PALM = np.stack(np.meshgrid(np.linspace(-0.10, 0.10, 21), np.linspace(-0.032, 0.032, 7)), axis=-1).reshape(-1, 2)
_FOOTPRINT_CLEARANCE_M = 0.003
_NEAR_PATCH_M = 0.002

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Closings:
    """The result of closing the jaw on n candidates; arrays of length n.

    Attributes:
        center_m: (n, 2) midpoint of the contacts in ``base``. ``heading_rad``: of the closing axis.
        tcp_m: height of the tcp above the table.
        edge_m: height of the surface just inside the contacts.
        width_m: distance between the contacts. ``opening_m``: hand width for the approach.
        terms: criteria, each between 0 and 1. ``score``: their weighted mean, -inf = not feasible.
    """

    center_m: Array
    heading_rad: Array
    tcp_m: Array
    edge_m: Array
    width_m: Array
    opening_m: Array
    terms: dict[str, Array]
    score: Array

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


def propose(heights: HeightMap, station: Station) -> Closings:
    """Candidates over the whole object, closed and scored."""
    pairs = [_contour_pairs(heights, share, station.hand) for share in _SLICES]
    centers = np.concatenate([pair[0] for pair in pairs])
    headings = np.concatenate([pair[1] for pair in pairs])
    widths = np.concatenate([pair[2] for pair in pairs])
    return close(heights, centers, headings, widths, station)


def close(heights: HeightMap, centers_m: Array, headings_rad: Array, widths_m: Array, station: Station) -> Closings:
    """Close the jaw on candidates.

    Args:
        centers_m: (n, 2) in ``base``. ``headings_rad``: (n,) of the closing axis. ``widths_m``: (n,) expected widths.
    """
    hand, clearance_m = station.hand, station.perception.approach_clearance_m
    axis = np.stack([np.cos(headings_rad), np.sin(headings_rad)], axis=1)
    half_m = np.minimum(hand.max_width_m, widths_m + 2 * clearance_m) / 2
    profile = _Profile(heights, centers_m, axis, hand)
    first_guess_m = np.maximum(0.5 * profile.top_m(half_m), station.perception.min_object_height_m)
    left, right = profile.contacts(first_guess_m, half_m)
    edge_m = np.minimum(profile.edge_m(left, +1.0), profile.edge_m(right, -1.0))
    lowest_m = FINGER_TIP_M + TABLE_CLEARANCE_M
    palm_m = _palm_top(heights, centers_m, axis) + TABLE_CLEARANCE_M - PALM_ABOVE_TIP_M + FINGER_TIP_M
    tcp_m = np.maximum(np.maximum(edge_m - _HOLD_M, lowest_m), palm_m)
    slice_m = np.minimum(tcp_m, 0.9 * edge_m)
    left, right = profile.contacts(slice_m, half_m)
    touches = np.isfinite(left).any(axis=1)
    touch_left, touch_right = (np.where(touches, touch, 0.0) for touch in (left.min(axis=1), right.max(axis=1)))
    width_m, shift_m = touch_right - touch_left, (touch_left + touch_right) / 2
    opening_m = np.minimum(hand.max_width_m, width_m + 2 * clearance_m)
    # Heights below the fingertips' table clearance count as the table and its noise.
    free_m = np.maximum(tcp_m - FINGER_TIP_M - _FOOTPRINT_CLEARANCE_M, TABLE_CLEARANCE_M)
    feasible = (
        touches
        & (width_m > hand.min_width_m)
        & (opening_m - width_m > _MIN_SLACK_M)
        & (tcp_m - FINGER_TIP_M < edge_m - _MIN_CONTACT_M)
        & (profile.under_fingers_m(shift_m, opening_m) < free_m)
    )
    cone = np.minimum(_face_cos(left, touch_left), _face_cos(right, touch_right))
    patch = ((left - touch_left[:, None] < _NEAR_PATCH_M) & (touch_right[:, None] - right < _NEAR_PATCH_M)).mean(axis=1)
    center_m = centers_m + axis * shift_m[:, None]
    feasible &= (cone > _FRICTION_COS) & (patch > 0)
    terms = {
        "flat": np.clip((cone - _FRICTION_COS) / (1 - _FRICTION_COS), 0, 1),
        "patch": patch,
        "margin": np.clip((hand.max_width_m - width_m) / (0.5 * hand.max_width_m), 0, 1),
        "depth": np.clip((edge_m - tcp_m) / _HOLD_M, 0, 1),
        "solid": profile.solid(slice_m, touch_left, touch_right),
        "central": 1 - np.minimum(_offset(heights, center_m), 2) / 2,
    }
    score = np.where(feasible, weighted(terms), -np.inf)
    return Closings(center_m, headings_rad, tcp_m, edge_m, width_m, opening_m, terms, score)


WEIGHTS = {"flat": 0.30, "patch": 0.25, "margin": 0.15, "depth": 0.15, "solid": 0.25, "central": 0.70}
"""Weights of the criteria: flat faces within the friction cone, long contact patches, room in the jaw, a deep hold,
material between the fingers (the two sides of a frame bend and turn), and closeness to the object's middle."""


def weighted(terms: dict[str, Array], weights: dict[str, float] = WEIGHTS) -> Array:
    """The weighted mean (n,) of named criteria, each (n,) and between 0 and 1."""
    total = sum(weights[name] for name in terms)
    return np.asarray(sum(weights[name] * value for name, value in terms.items()) / total)


def _offset(heights: HeightMap, center_m: Array) -> Array:
    """Distance (n,) of the centres from the object's middle, in rms radii."""
    rows, columns = np.nonzero(heights.is_object)
    cells = heights.xy_m(rows, columns)
    middle, radius_m = cells.mean(axis=0), float(np.sqrt(((cells - cells.mean(axis=0)) ** 2).sum(axis=1).mean()))
    return np.asarray(np.linalg.norm(center_m - middle, axis=1) / max(radius_m, 0.01))


class _Profile:
    """Heights along the closing axis of n candidates: 7 rays across the finger, 1 mm steps."""

    def __init__(self, heights: HeightMap, centers_m: Array, axis: Array, hand: HandSettings) -> None:
        reach_m = hand.max_width_m / 2 + hand.finger_thickness_m + 0.012
        self.t_m = np.arange(-reach_m, reach_m + _STEP_M / 2, _STEP_M)
        lateral = np.stack([-axis[:, 1], axis[:, 0]], axis=1)
        x, y = (
            centers_m[:, k, None, None]
            + axis[:, k, None, None] * self.t_m[None, None, :]
            + lateral[:, k, None, None] * _RAYS[None, :, None]
            for k in (0, 1)
        )
        self.heights_m = heights.at(x, y)
        self._finger_m = hand.finger_thickness_m + 0.004

    def top_m(self, half_m: Array) -> Array:
        """Height (n,) of the highest point between the opened fingers."""
        inside = np.abs(self.t_m)[None, None, :] <= half_m[:, None, None]
        return np.asarray(np.where(inside, self.heights_m, 0.0).max(axis=(1, 2)))

    def contacts(self, slice_m: Array, half_m: Array) -> tuple[Array, Array]:
        """Position (n, 7) where each ray first meets material from the left and from the right; +-inf for none."""
        inside = np.abs(self.t_m)[None, None, :] <= half_m[:, None, None]
        solid = (self.heights_m > slice_m[:, None, None]) & inside
        hit = solid.any(axis=2)
        left = np.where(hit, self.t_m[solid.argmax(axis=2)], np.inf)
        right = np.where(hit, self.t_m[::-1][solid[..., ::-1].argmax(axis=2)], -np.inf)
        return left, right

    def edge_m(self, contact: Array, inward: float) -> Array:
        """Median height of the surface 3 mm inside the contacts (n,)."""
        hit = np.isfinite(contact)
        position = np.where(hit, contact, 0.0) + inward * 0.003
        index = np.rint((position - self.t_m[0]) / _STEP_M).astype(int).clip(0, len(self.t_m) - 1)
        height = np.take_along_axis(self.heights_m, index[..., None], axis=2)[..., 0]
        return np.nan_to_num(_median(np.where(hit, height, np.nan)))

    def solid(self, slice_m: Array, left_m: Array, right_m: Array) -> Array:
        """Share (n,) of the space between the contacts that is at least as high as the slice."""
        between = (self.t_m >= left_m[:, None]) & (self.t_m <= right_m[:, None])
        filled = (self.heights_m > slice_m[:, None, None]).mean(axis=1)
        return np.asarray((filled * between).sum(axis=1) / np.maximum(between.sum(axis=1), 1))

    def under_fingers_m(self, shift_m: Array, opening_m: Array) -> Array:
        """Height (n,) of the highest point below either opened finger."""
        out = np.abs(self.t_m[None, :] - shift_m[:, None])
        inner = opening_m[:, None] / 2
        under = (out >= inner) & (out <= inner + self._finger_m)
        return np.asarray(np.where(under[:, None, :], self.heights_m, 0.0).max(axis=(1, 2)))


def _median(values: Array) -> Array:
    """Median along the last axis, ignoring NaN; NaN for all-NaN rows, without numpy's warning."""
    ordered = np.sort(values, axis=-1)  # NaN last
    count = np.isfinite(values).sum(axis=-1)
    middle = np.maximum(count - 1, 0) // 2
    return np.asarray(np.take_along_axis(ordered, middle[:, None], axis=-1)[:, 0])


def _palm_top(heights: HeightMap, centers_m: Array, axis: Array) -> Array:
    """Height (n,) of the highest point below the palm."""
    lateral = np.stack([-axis[:, 1], axis[:, 0]], axis=1)
    points = centers_m[:, None] + axis[:, None] * _PALM[None, :, :1] + lateral[:, None] * _PALM[None, :, 1:]
    return np.asarray(heights.at(points[..., 0], points[..., 1]).max(axis=1))


def _face_cos(contacts: Array, touch: Array) -> Array:
    """Cosine (n,) of the angle between the closing axis and the normal of a line through the near contacts."""
    near = np.abs(contacts - touch[:, None]) < 0.004
    weight = near.astype(float)
    total = np.maximum(weight.sum(axis=1), 1e-9)
    values = np.where(near, contacts, 0.0)
    mean_l = (weight * _RAYS).sum(axis=1) / total
    mean_t = (weight * values).sum(axis=1) / total
    spread = (weight * (_RAYS - mean_l[:, None]) ** 2).sum(axis=1)
    slope = (weight * (_RAYS - mean_l[:, None]) * (values - mean_t[:, None])).sum(axis=1) / np.maximum(spread, 1e-12)
    return np.asarray(np.where(near.sum(axis=1) >= 2, 1 / np.sqrt(1 + slope**2), 0.0))


def _contour_pairs(heights: HeightMap, share: float, hand: HandSettings) -> tuple[Array, Array, Array]:
    """Centres (n, 2), headings (n,) and widths (n,) of opposing contour points of one slice, the most central first."""
    top_m = float(np.percentile(heights.height_m[heights.is_object], 95))
    solid = heights.is_object & (heights.height_m > share * top_m)
    smooth = ndimage.gaussian_filter(solid.astype(float), 1.5)
    rim = solid & ~ndimage.binary_erosion(solid)
    rows, columns = np.nonzero(rim)
    keep = slice(None, None, max(1, -(-len(rows) // _CONTOUR_POINTS)))
    rows, columns = rows[keep], columns[keep]
    gradient = np.stack(np.gradient(smooth)[::-1], axis=-1)[rows, columns]  # (x, y), towards the material
    inward = gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-9)
    points = heights.xy_m(rows, columns)
    i, j = np.triu_indices(len(points), k=1)
    across = points[j] - points[i]
    width = np.linalg.norm(across, axis=1)
    direction = across / np.maximum(width[:, None], 1e-9)
    facing = np.minimum((inward[i] * direction).sum(axis=1), -(inward[j] * direction).sum(axis=1))
    fits = (facing > _FRICTION_COS) & (width + CELL_M < hand.max_width_m) & (width > 0)
    i, j, direction, width, facing = i[fits], j[fits], direction[fits], width[fits] + CELL_M, facing[fits]
    middle = points.mean(axis=0) if len(points) else np.zeros(2)
    center = (points[i] + points[j]) / 2
    rank = np.argsort(np.linalg.norm(center - middle, axis=1) - 0.05 * facing, kind="stable")[:_CANDIDATES]
    return center[rank], np.arctan2(direction[rank, 1], direction[rank, 0]), width[rank]
