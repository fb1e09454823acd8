"""Draws grasps along one direction from the true shapes: from above, or from a side. In metres.

Frame: ``side``, whose z is up against the approach. Of grasps from above it is ``table``, whose top is z = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull

from benchmarks.heaps.clipping import Solid, half_spaces, moved
from benchmarks.heaps.heap import FIXED, Heap
from benchmarks.heaps.swept import PALM_SIZE_M
from bus.transforms import apply, from_rotation, inverse
from config.devices import HandSettings
from config.franka_hand import FINGER_TIP_M, PALM_ABOVE_TIP_M

_CELL_M = 0.002
_MARGIN_M = 0.13
"""Around the pick region: the palm reaches so far."""
_CLEARANCE_M = 0.0045
_OVER_M = 0.0015
"""Of the tips over what lies under the fingers."""
_BELOW_M = (0.003, 0.010, 0.020)
_ABOVE_LOWEST_M = (0.0, 0.006, 0.014, 0.024)
_OPENINGS_M = (0.080, 0.060, 0.044, 0.030, 0.018, 0.010)
_LEAST_BITE_M = 0.002
_STEEPEST = 0.45
"""Largest vertical component of the normal of a face that a pad may press on: 27 degrees, the friction cone."""
_UNDER_M = 0.05
"""Below the lowest body nothing is looked for."""
_EDGE_ON = 1e-6

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Candidates:
    """Grasps in ``side``, all (n, ...): the jaw's middle (x, y), the tips' height, the axis's heading, the opening."""

    center_m: Array
    tip_m: Array
    heading_rad: Array
    opening_m: Array

    def __len__(self) -> int:
        return len(self.tip_m)

    def side_from_tcp(self, index: int) -> Array:
        """Return the pose (4, 4): tcp z down in ``side``, tcp y along the heading."""
        cosine, sine = float(np.cos(self.heading_rad[index])), float(np.sin(self.heading_rad[index]))
        closing, down = np.array([cosine, sine, 0.0]), np.array([0.0, 0.0, -1.0])
        rotation = np.stack([np.cross(closing, down), closing, down], axis=1)
        return from_rotation(rotation, (*self.center_m[index], self.tip_m[index] + FINGER_TIP_M))

    def where(self, kept: npt.NDArray[np.bool_] | npt.NDArray[np.int64]) -> Candidates:
        """Return some of them."""
        return Candidates(self.center_m[kept], self.tip_m[kept], self.heading_rad[kept], self.opening_m[kept])

    def and_(self, more: Candidates) -> Candidates:
        """Return these, then ``more``."""
        both = [np.concatenate(pair) for pair in zip(self._all, more._all, strict=True)]
        return Candidates(*both)

    @property
    def _all(self) -> tuple[Array, ...]:
        return self.center_m, self.tip_m, self.heading_rad, self.opening_m


class Truth:
    """The true shapes of one scene in ``side``, and the height of what stands highest over each cell.

    Args:
        table_from_side: (4, 4); None = the identity: grasps from above.

    Attributes:
        height_m: (rows, columns) of the highest of all shapes and the table; infinite where the table is in the way.
    """

    def __init__(self, heap: Heap, table_from_side: Array | None = None) -> None:
        leaning = np.eye(4) if table_from_side is None else table_from_side
        self._base_from_side = heap.base_from_table @ leaning
        side_from_base = inverse(self._base_from_side)
        self._hand: HandSettings = heap.station().hand
        self._region_m = heap.station().scene.pick_region_m
        self._bodies = np.array([part.body for part in heap.parts])
        self._corners = [apply(side_from_base, part.corners) for part in heap.parts]
        self._solids = [moved(half_spaces(part.corners), part.corners, side_from_base) for part in heap.parts]
        low, high = self._loose()
        if table_from_side is None:
            low[:2], high[:2] = self._region_m[::2], self._region_m[1::2]
        self._origin_m = low[:2] - _MARGIN_M
        size_m = high[:2] - low[:2] + 2 * _MARGIN_M
        self._floor_m = self._table(inverse(leaning), *np.ceil(size_m / _CELL_M).astype(int))
        self._floor_m = np.maximum(self._floor_m, low[2] - _UNDER_M)
        self.height_m = self._heights()

    def _loose(self) -> tuple[Array, Array]:
        """The box (2 x (3,)) of all bodies."""
        corners = [part for part, body in zip(self._corners, self._bodies, strict=True) if body != FIXED]
        every = np.concatenate(corners) if corners else np.zeros((1, 3))
        return every.min(axis=0), every.max(axis=0)

    def _table(self, side_from_table: Array, rows: int, columns: int) -> Array:
        """The table's height (rows, columns) in ``side``; -inf and inf before and behind one that is seen edge-on."""
        up, on_table = side_from_table[:3, 2], side_from_table[:3, 3]
        x, y = (self._origin_m[axis] + _CELL_M * np.arange(count) for axis, count in ((0, rows), (1, columns)))
        over_m = up[0] * (x[:, None] - on_table[0]) + up[1] * (y - on_table[1])
        if abs(up[2]) < _EDGE_ON:
            return np.where(over_m < 0, np.inf, -np.inf)
        return np.asarray(on_table[2] - over_m / up[2])

    def _heights(self) -> Array:
        heights = self._floor_m.copy()
        rows, columns = heights.shape
        for solid in self._solids:
            low, high = (np.rint((edge[:2] - self._origin_m) / _CELL_M).astype(int) for edge in (solid.low, solid.high))
            first, last = np.maximum(low, 0), np.minimum(high + 1, (rows, columns))
            if (first >= last).any():
                continue
            i, j = (one.ravel() for one in np.mgrid[first[0] : last[0], first[1] : last[1]])
            lines = np.column_stack([self._origin_m + _CELL_M * np.stack([i, j], axis=1), np.zeros(i.size)])
            np.maximum.at(heights, (i, j), solid.clip(lines, 2).leave)
        return heights

    def poses(self, drawn: Candidates) -> list[tuple[Array, float]]:
        """Return ``base_from_tcp`` (4, 4) and opening of each."""
        return [
            (self._base_from_side @ drawn.side_from_tcp(index), float(drawn.opening_m[index]))
            for index in range(len(drawn))
        ]

    # --- drawing -----------------------------------------------------------------------------------------------------

    def on_faces(self, count: int, rng: np.random.Generator) -> Candidates:
        """Draw grasps square to upright faces: a point on one, the heading of its normal, what lies behind it."""
        faces = [self._upright(int(part)) for part in np.flatnonzero(self._bodies != FIXED)]
        points, normals, parts = (np.concatenate(one) for one in zip(*faces, strict=True))
        if not len(points):
            return self._none()
        points = points[chosen := rng.integers(0, len(points), count)]
        normals, parts = normals[chosen], parts[chosen]
        start, end = self._through(points, normals, parts)
        width_m, middle = end - start, points[:, :2] + normals * ((start + end) / 2)[:, None]
        heading_rad = np.arctan2(normals[:, 1], normals[:, 0])
        opening_m = np.minimum(self._hand.max_width_m, width_m + 2 * _CLEARANCE_M)
        lowest_m = self._lowest(middle, heading_rad, opening_m)
        tip_m = np.maximum(lowest_m, points[:, 2] - rng.choice(_BELOW_M, count))
        fits = (width_m < opening_m - _LEAST_BITE_M) & (tip_m < points[:, 2] - _LEAST_BITE_M)
        return self._inside(Candidates(middle, tip_m, heading_rad, opening_m).where(fits))

    def anywhere(self, count: int, rng: np.random.Generator) -> Candidates:
        """Draw grasps with something between the pads, at any heading, opening and free height."""
        cells = np.argwhere(self.height_m > self._floor_m + _LEAST_BITE_M)
        if not len(cells):
            return self._none()
        center_m = self._origin_m + _CELL_M * cells[rng.integers(0, len(cells), count)]
        heading_rad, opening_m = rng.uniform(-np.pi, np.pi, count), rng.choice(_OPENINGS_M, count)
        lowest_m = self._lowest(center_m, heading_rad, opening_m)
        tip_m = lowest_m + rng.choice(_ABOVE_LOWEST_M, count)
        top_m = self._top(center_m, heading_rad, np.zeros(count), (0.018, 0.0), opening_m)
        return self._inside(Candidates(center_m, tip_m, heading_rad, opening_m).where(top_m > tip_m + _LEAST_BITE_M))

    def _none(self) -> Candidates:
        return Candidates(np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0))

    def _upright(self, part: int) -> tuple[Array, Array, npt.NDArray[np.int64]]:
        """Points (k, 3) on upright faces of a part, their level unit normals (k, 2), and the part's index (k,)."""
        hull = ConvexHull(self._corners[part])
        normals = hull.equations[:, :3]
        upright = np.flatnonzero(np.abs(normals[:, 2]) < _STEEPEST)
        corners = hull.points[hull.simplices[upright]]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        times = np.minimum(1 + (area / 2 / 4e-6).astype(int), 200)  # a point for 4 mm^2
        rng = np.random.default_rng(part)
        chosen = np.repeat(np.arange(len(upright)), times)
        shares = rng.dirichlet((1, 1, 1), len(chosen))
        points = np.einsum("nk,nkd->nd", shares, corners[chosen])
        level = normals[upright[chosen], :2]
        return points, level / np.linalg.norm(level, axis=1, keepdims=True), np.full(len(chosen), part)

    def _through(self, points: Array, normals: Array, parts: npt.NDArray[np.int64]) -> tuple[Array, Array]:
        """Return how far the body of each point reaches along its normal: least (n,) and greatest (n,) of its parts."""
        start, end = np.zeros(len(points)), np.zeros(len(points))
        reach_m = self._hand.max_width_m
        for index, (point, normal) in enumerate(zip(points, normals, strict=True)):
            turn = np.array([[normal[0], normal[1], 0], [-normal[1], normal[0], 0], [0, 0, 1.0]])
            line_from_side = from_rotation(turn, -turn @ point)
            for part in np.flatnonzero(self._bodies == self._bodies[parts[index]]):
                solid = self._solids[part]
                if (solid.low > point + reach_m).any() or (solid.high < point - reach_m).any():
                    continue
                chord = _turned(solid, line_from_side).clip(np.zeros((1, 3)), 0)
                entry, leave = float(chord.entry[0]), float(chord.leave[0])
                if entry < reach_m and leave > -reach_m:
                    start[index], end[index] = min(start[index], entry), max(end[index], leave)
        return start, end

    # --- looking up --------------------------------------------------------------------------------------------------

    def _lowest(self, center_m: Array, heading_rad: Array, opening_m: Array) -> Array:
        """The lowest tip (n,) at which fingers and palm are free, as far as the cells tell."""
        zero, thick = np.zeros(len(center_m)), self._hand.finger_thickness_m
        off_m, finger = (opening_m + thick) / 2, (self._hand.finger_width_m, thick)
        left = self._top(center_m, heading_rad, -off_m, finger)
        right = self._top(center_m, heading_rad, off_m, finger)
        palm = self._top(center_m, heading_rad, zero, PALM_SIZE_M) - PALM_ABOVE_TIP_M
        return np.asarray(np.maximum(np.maximum(left, right), palm) + _OVER_M)

    def _top(
        self,
        center_m: Array,
        heading_rad: Array,
        off_m: Array,
        size_m: tuple[float, float],
        more_m: Array | None = None,
    ) -> Array:
        """The highest (n,) under rectangles ``off_m`` (n,) along the closing axis.

        Args:
            size_m: across and along the closing axis. ``more_m``: (n,) added along it.
        """
        along_m = size_m[1] + (np.zeros(len(center_m)) if more_m is None else more_m)
        longest_m = float(along_m.max(initial=0.0))
        u = np.linspace(-0.5, 0.5, max(2, round(longest_m / 0.003) + 1))
        v = np.linspace(-size_m[0] / 2, size_m[0] / 2, max(2, round(size_m[0] / 0.003) + 1))
        axis = np.stack([np.cos(heading_rad), np.sin(heading_rad)], axis=1)
        side = np.stack([-axis[:, 1], axis[:, 0]], axis=1)
        t = off_m[:, None] + along_m[:, None] * u
        place = center_m[:, None, None] + axis[:, None, None] * t[:, :, None, None] + side[:, None, None] * v[:, None]
        cell = np.rint((place - self._origin_m) / _CELL_M).astype(int)
        rows, columns = self.height_m.shape
        cell[..., 0].clip(0, rows - 1, out=cell[..., 0])
        cell[..., 1].clip(0, columns - 1, out=cell[..., 1])
        return np.asarray(self.height_m[cell[..., 0], cell[..., 1]].max(axis=(1, 2)))

    def _inside(self, drawn: Candidates) -> Candidates:
        """Those whose middle lies in the pick region."""
        x_min, x_max, y_min, y_max = self._region_m
        places = apply(self._base_from_side, np.column_stack([drawn.center_m, drawn.tip_m]))
        x, y = places[:, 0], places[:, 1]
        return drawn.where((x > x_min) & (x < x_max) & (y > y_min) & (y < y_max))


def _turned(solid: Solid, line_from_side: Array) -> Solid:
    turn, shift = line_from_side[:3, :3], line_from_side[:3, 3]
    normals = solid.normals @ turn.T
    return Solid(normals, solid.offsets - normals @ shift, solid.low, solid.high)
