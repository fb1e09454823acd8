"""Searches a whole height map for grasps: every heading, every height, every place where fingers fit beside material.

For each heading the map is turned so that the closing axis is x. Runs of material between free room on both sides
become candidates; a share of them, spread evenly over places and headings, is closed and scored.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import cv2
import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from bus.transforms import apply
from config.devices import HandSettings
from config.franka_hand import PALM_ABOVE_TIP_M
from config.schema import Station
from perception.grasps.closing import TABLE_CLEARANCE_M, Closings, close, joined, weighted
from perception.scene.heightmap import CELL_M, HeightMap, Heights

_ROW_CELLS = 2
_GROUP_CELLS, _MARGIN_CELLS = 21, 65
"""Things less than 40 mm apart are looked at together; around them, as far as the palm reaches."""
_FINGER_ACROSS_M, _PALM_M = 0.020, (0.20, 0.064)
_PAD_M = 0.018
_MIN_WIDTH_M, _OVER_TIP_M = 0.003, 0.003
_BIN_M = 0.010
"""Candidates are picked by turns from bins of this size and each heading, so that no part of the scene is left out."""
_TESTED = 90
_BEST, _BEST_APART_M, _BEST_APART_RAD = 30, 0.010, float(np.deg2rad(15))
_TURNS_RAD, _SIDES_M = np.deg2rad([-8.0, -4.0, 0.0, 4.0, 8.0]), np.array([-0.004, 0.0, 0.004])
_FEWER = 0.5
"""Below this share of the most candidates, those with little room for the fingers are added."""
_CLEARANCES_M = (0.004, 0.002)
_ERRORS = np.array([[0.003, 0, 0], [-0.003, 0, 0], [0, 0.003, 0], [0, -0.003, 0], [0, 0, 0.087], [0, 0, -0.087]])
"""Pose errors that a grasp should survive: along and across the closing axis [m], and of the heading [rad]."""
_ROBUST_CLEARANCE_M = 0.0035

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Density:
    """The density of a search: headings, the distance of tip heights, and how many candidates are closed."""

    headings: int
    level_m: float
    most: int


USUAL = Density(headings=16, level_m=0.008, most=900)
CLOSE = Density(headings=32, level_m=0.004, most=3000)
"""Four times the work, for a scene in which the usual search finds nothing: what fits narrowly lies in between."""


@dataclass(frozen=True)
class Candidates:
    """Places to close the jaw at; arrays of length n. ``clearance_m``: room of each finger there."""

    center_m: Array
    heading_rad: Array
    slice_m: Array
    clearance_m: Array

    @classmethod
    def joined(cls, parts: list[Candidates]) -> Candidates:
        """Several candidates as one, in their order."""
        return cls(*(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(cls)))

    def taken(self, chosen: npt.NDArray[np.integer] | npt.NDArray[np.bool_]) -> Candidates:
        """Return the chosen ones, in their order."""
        return Candidates(*(getattr(self, one.name)[chosen] for one in fields(self)))


def search(
    heights: HeightMap, station: Station, base_from_level: Transform | None = None, density: Density = USUAL
) -> Closings:
    """Closings all over the map, scored, the best of them also by how many pose errors they survive.

    Args:
        base_from_level: (4, 4) the map's frame; None = from above, with the x and y of ``base``.
    """
    found = _everywhere(heights, station, density)
    found = found.taken(_in_region(found, station, base_from_level))
    roomy = found.taken(found.clearance_m == _CLEARANCES_M[0])
    chosen = _spread(found if len(roomy.center_m) < _FEWER * density.most else roomy, density.most)
    coarse = close(heights, chosen.center_m, chosen.heading_rad, chosen.slice_m, station)
    fine = _refined(coarse, heights, station)
    return tested(joined([coarse, fine]), heights, station, _TESTED)


def _everywhere(heights: HeightMap, station: Station, density: Density) -> Candidates:
    """The candidates of every group of things; between groups that lie apart nothing is looked for."""
    parts = [Candidates(np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0))]
    near = cv2.dilate((heights.labels > 0).astype(np.uint8), np.ones((_GROUP_CELLS, _GROUP_CELLS), np.uint8))
    _, _, boxes, _ = cv2.connectedComponentsWithStats(near)
    for left, top, width, height, _ in boxes[1:]:
        margin = _MARGIN_CELLS - _GROUP_CELLS // 2
        window = np.s_[max(0, top - margin) : top + height + margin, max(0, left - margin) : left + width + margin]
        group = heights.part(window)
        headings_rad = np.arange(density.headings) * np.pi / density.headings
        parts += [_along(group, float(heading_rad), station, density.level_m) for heading_rad in headings_rad]
    return Candidates.joined(parts)


def _in_region(found: Candidates, station: Station, base_from_level: Transform | None) -> npt.NDArray[np.bool_]:
    """Whether the candidates (n,) lie in the pick region."""
    x_min, x_max, y_min, y_max = station.scene.pick_region_m
    x, y = found.center_m.T
    if base_from_level is not None:
        x, y, _ = apply(base_from_level, np.column_stack([found.center_m, found.slice_m])).T
    return np.asarray((x > x_min) & (x < x_max) & (y > y_min) & (y < y_max))


def _refined(closings: Closings, heights: HeightMap, station: Station) -> Closings:
    """The best distinct closings, turned and moved across by a little: the search's headings are 11 deg apart."""
    best = closings.taken(closings.distinct(_BEST, _BEST_APART_M, _BEST_APART_RAD))
    turn_rad, side_m = (grid.ravel() for grid in np.meshgrid(_TURNS_RAD, _SIDES_M))
    headings = best.heading_rad[:, None] + turn_rad
    across = np.stack([-np.sin(best.heading_rad), np.cos(best.heading_rad)], axis=1)
    centers = best.center_m[:, None] + side_m[:, None] * across[:, None]
    slices_m = np.repeat(best.slice_m, len(turn_rad))
    return close(heights, centers.reshape(-1, 2), headings.ravel(), slices_m, station)


def tested(closings: Closings, heights: HeightMap, station: Station, most: int) -> Closings:
    """Add the term ``robust`` to the closings: the best ``most`` are tested, the others count as surviving nothing."""
    feasible = np.argsort(-closings.score, kind="stable")[: min(most, int(np.isfinite(closings.score).sum()))]
    robust = np.zeros(len(closings.score))
    robust[feasible] = _survived(closings, feasible, heights, station)
    terms = {**closings.terms, "robust": robust}
    return replace(closings, terms=terms, score=np.where(np.isfinite(closings.score), weighted(terms), -np.inf))


def _survived(closings: Closings, chosen: npt.NDArray[np.intp], heights: HeightMap, station: Station) -> Array:
    """Share (n,) of the pose errors after which the jaw still closes."""
    heading = closings.heading_rad[chosen]
    along = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    centers = closings.center_m[chosen, None] + _ERRORS[:, :1] * along[:, None] + _ERRORS[:, 1:2] * across[:, None]
    headings = (heading[:, None] + _ERRORS[:, 2]).ravel()
    slices_m = np.repeat(closings.slice_m[chosen], len(_ERRORS))
    erred = close(heights, centers.reshape(-1, 2), headings, slices_m, station, clearance_m=_ROBUST_CLEARANCE_M)
    same = erred.instance == np.repeat(closings.instance[chosen], len(_ERRORS))
    return np.asarray((np.isfinite(erred.score) & same).reshape(len(chosen), len(_ERRORS)).mean(axis=1))


def _along(heights: HeightMap, heading_rad: float, station: Station, level_m: float) -> Candidates:
    """Every run of material along one heading with room for the fingers."""
    turned, hand = _Turned.of(heights, heading_rad), station.hand
    is_object = turned.is_object[::_ROW_CELLS]
    finger = turned.highest_around(turned.bound_m, hand.finger_thickness_m, _FINGER_ACROSS_M)[::_ROW_CELLS]
    palm = turned.highest_around(turned.bound_m, *_PALM_M)[::_ROW_CELLS]
    pad = turned.highest_around(turned.surface_m, 0.0, _PAD_M)[::_ROW_CELLS]
    top_m = np.where(is_object, pad, np.float32(0)).max(axis=1)
    # all levels at once: one by one, most of the time would go into the calls
    tips_m = _levels(float(top_m.max(initial=0.0)), level_m)
    level, row = np.nonzero(top_m > tips_m[:, None] + _OVER_TIP_M)
    run, first, last = _runs(pad[row] > tips_m[level, None] + _OVER_TIP_M, hand)
    level, row, middle = level[run], row[run], (first + last) // 2
    free = (palm[row, middle] < tips_m[level] + PALM_ABOVE_TIP_M - 0.001) & is_object[row, middle]
    level, row, first, last = level[free], row[free], first[free], last[free]
    fits = [_has_room(finger, tips_m[level] - 0.001, row, first, last, room_m, hand) for room_m in _CLEARANCES_M]
    kept = np.concatenate([np.flatnonzero(one) for one in fits])
    room_m = np.repeat(_CLEARANCES_M, [int(one.sum()) for one in fits])
    order = np.argsort(level[kept], kind="stable")
    kept, room_m = kept[order], room_m[order]
    center_m = turned.xy_m(np.stack([(first + last)[kept] / 2, row[kept] * _ROW_CELLS], axis=1))
    return Candidates(center_m, np.full(len(kept), heading_rad), tips_m[level[kept]] + _OVER_TIP_M, room_m)


def _has_room(
    finger: Heights,
    below_m: Array,
    row: npt.NDArray[np.intp],
    first: npt.NDArray[np.intp],
    last: npt.NDArray[np.intp],
    clearance_m: float,
    hand: HandSettings,
) -> npt.NDArray[np.bool_]:
    """Whether both fingers (n,), so far beside their run, stand on what is lower than ``below_m`` (n,)."""
    beside = (clearance_m + hand.finger_thickness_m / 2) / CELL_M
    left = np.clip(np.rint(first - beside).astype(int), 0, finger.shape[1] - 1)
    right = np.clip(np.rint(last + beside).astype(int), 0, finger.shape[1] - 1)
    return np.asarray((finger[row, left] < below_m) & (finger[row, right] < below_m))


def _levels(top_m: float, level_m: float) -> Array:
    """Tip heights to look at, from the table up to just below the highest object."""
    return np.arange(TABLE_CLEARANCE_M, max(top_m - 0.004, TABLE_CLEARANCE_M + 1e-4), level_m)


def _runs(
    solid: npt.NDArray[np.bool_], hand: HandSettings
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Row, first and last column of every run along the rows that fits into the jaw; also of two neighbours as one."""
    framed = np.zeros((len(solid), solid.shape[1] + 2), dtype=bool)
    framed[:, 1:-1] = solid
    changes = np.flatnonzero(framed[:, 1:] != framed[:, :-1])  # begin and end of every run, by turns
    row, first = np.divmod(changes[::2], solid.shape[1] + 1)
    last = changes[1::2] % (solid.shape[1] + 1) - 1
    pair = np.flatnonzero(row[1:] == row[:-1])
    row, first, last = (
        np.concatenate(both) for both in ((row, row[pair]), (first, first[pair]), (last, last[pair + 1]))
    )
    width_m = (last - first + 1) * CELL_M
    fits = (width_m >= _MIN_WIDTH_M) & (width_m <= hand.max_width_m)
    return row[fits], first[fits], last[fits]


def _spread(found: Candidates, most: int) -> Candidates:
    """At most ``most`` of the candidates, by turns from bins of place and heading, the deepest of each bin first."""
    place = np.floor(found.center_m / _BIN_M).astype(np.int64)
    keys = np.column_stack([place, np.rint(found.heading_rad * 1e3).astype(np.int64)])
    order = np.lexsort((found.slice_m, keys[:, 2], keys[:, 1], keys[:, 0]))
    ordered = keys[order]
    starts = np.flatnonzero(np.r_[True, (ordered[1:] != ordered[:-1]).any(axis=1)]) if len(order) else np.zeros(0, int)
    turn = np.arange(len(order)) - np.repeat(starts, np.diff(np.r_[starts, len(order)]))
    kept = order[np.argsort(turn, kind="stable")]
    first_turn = int((turn == 0).sum())
    if first_turn > most:
        kept = kept[np.linspace(0, first_turn - 1, most).astype(int)]
    return found.taken(kept[:most])


@dataclass(frozen=True)
class _Turned:
    """A height map turned so that the closing axis is x. ``origin_m``, ``axis``: its place in the level frame."""

    surface_m: Heights
    bound_m: Heights
    is_object: npt.NDArray[np.bool_]
    center_m: Array
    heading_rad: float

    @classmethod
    def of(cls, heights: HeightMap, heading_rad: float) -> _Turned:
        """Turn a map about its middle."""
        ny, nx = heights.surface_m.shape
        c, s = np.cos(heading_rad), np.sin(heading_rad)
        size = (int(np.ceil(abs(nx * c) + abs(ny * s))), int(np.ceil(abs(nx * s) + abs(ny * c))))
        middle, center = np.array([nx - 1, ny - 1]) / 2, np.array([size[0] - 1, size[1] - 1]) / 2
        turn = np.array([[c, -s], [s, c]])
        matrix = np.column_stack([turn, middle - turn @ center])

        def warped(image: npt.NDArray[np.generic], beyond: float) -> npt.NDArray[np.float32]:
            flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
            turned = cv2.warpAffine(
                image,
                matrix,
                size,
                flags=flags,
                borderMode=cv2.BORDER_CONSTANT,
                borderValue=(beyond,),
            )
            return np.asarray(turned)

        return cls(
            warped(heights.surface_m, 0.0),
            warped(heights.bound_m, 0.2),
            warped((heights.labels > 0).astype(np.uint8), 0.0) > 0,
            heights.origin_m + middle * CELL_M,
            heading_rad,
        )

    def highest_around(self, image: Heights, along_m: float, across_m: float) -> Heights:
        """The highest value in a box around each cell: ``along_m`` on x, ``across_m`` on y."""
        box = np.ones((_odd(across_m), _odd(along_m)), np.uint8)
        return np.asarray(cv2.dilate(image, box, borderType=cv2.BORDER_REPLICATE))

    def xy_m(self, cells: Array) -> Array:
        """Positions (n, 2) in the level frame of cells (n, 2) = (column, row)."""
        off = (cells - np.array([self.surface_m.shape[1] - 1, self.surface_m.shape[0] - 1]) / 2) * CELL_M
        c, s = np.cos(self.heading_rad), np.sin(self.heading_rad)
        return np.asarray(self.center_m + off @ np.array([[c, s], [-s, c]]))


def _odd(length_m: float) -> int:
    return round(length_m / CELL_M) | 1
