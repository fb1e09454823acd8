"""Judges a grasp on the true shapes: is the way there free, what do the pads meet, and do the contacts hold it?

All in the grasp's own frame: x across the finger, y the closing axis, z up against the approach, the origin between the
finger tips. So the approach may come from above, lean, or come from the side. Stricter than physics: nothing may turn
or slide into the jaw, and the hand comes straight from far away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from benchmarks.heaps.clipping import Solid, box_near, half_spaces, moved
from benchmarks.heaps.heap import FIXED, Heap, Part
from benchmarks.heaps.swept import TCP_FROM_GRASP, Hand
from bus.transforms import inverse
from config.devices import CameraSettings, HandSettings

TRUE, SEAM, COLLIDES, SLIPS, THIN, OFF, NOTHING = "true", "seam", "collides", "slips", "thin", "off", "nothing"
VERDICTS = (TRUE, SEAM, COLLIDES, SLIPS, THIN, OFF, NOTHING)

FRICTION = 0.5
_PAD_M, _PAD_LINES = 0.019, 14
_LOW_M, _HIGH_M, _HIGH_LINES = 0.0005, 0.041, 18
_RUBBER_M = 0.001
"""Contacts this near to the first one belong to its patch: the pad yields."""
_THINNEST_M, _LEAST_LINES = 0.002, 3
_OFF_MIDDLE_M = 0.008
_CONE_COS = float(1 / np.hypot(1.0, FRICTION))

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Verdict:
    """The judgement of a grasp.

    Attributes:
        name: one of `VERDICTS`. ``why``: a few words.
        body: index of the body that is held, where it is one.
        width_m: between the contacts; NaN without any.
    """

    name: str
    why: str = ""
    body: int | None = None
    width_m: float = float("nan")


@dataclass(frozen=True)
class _Patch:
    """The contacts of one pad: (k, 3) places, (k, 3) outward normals of the facets, and (k,) bodies."""

    places: Array
    normals: Array
    bodies: npt.NDArray[np.int64]


class Judge:
    """Judges grasps in one scene.

    Args:
        parts: of all bodies and fixed things, in ``base``.
        base_from_table: (4, 4); the table's top is z = 0 of ``table``.
        hand: gives the fingers' width and thickness, and the widest opening.
        camera: gives its place on the hand; None = the default's.
    """

    def __init__(
        self,
        parts: Sequence[Part],
        base_from_table: Array,
        hand: HandSettings,
        camera: CameraSettings | None = None,
    ) -> None:
        self._parts = [(part.body, half_spaces(part.corners), part.corners) for part in parts]
        self._table, self._widest_m = base_from_table, hand.max_width_m
        self._hand = Hand(hand, camera or CameraSettings())

    @classmethod
    def of(cls, heap: Heap) -> Judge:
        """Return the judge of a scene."""
        station = heap.station()
        return cls(heap.parts, heap.base_from_table, station.hand, station.camera)

    def judge(self, base_from_tcp: Array, opening_m: float) -> Verdict:
        """Judge a grasp.

        Args:
            base_from_tcp: (4, 4): tcp z = approach, tcp y = closing axis, as `bus.messages.Grasp`.
            opening_m: between the pads on the way down; more than the hand's widest counts as that.
        """
        half_m = min(opening_m, self._widest_m) / 2
        grasp_from_base = inverse(base_from_tcp @ TCP_FROM_GRASP)
        near = [(body, moved(planes, corners, grasp_from_base)) for body, planes, corners in self._parts]
        near = [(body, solid) for body, solid in near if box_near(solid, *self._hand.reach(half_m))]
        hit = self._hand.hit(near, grasp_from_base @ self._table, half_m)
        return Verdict(COLLIDES, hit) if hit else self._closed(near, half_m)

    def overlap_m(self, base_from_tcp: Array, opening_m: float) -> tuple[float, float]:
        """Return how far up from the tips both pads touch, and how high over the table that is; zeros for no touch."""
        half_m, base_from_grasp = min(opening_m, self._widest_m) / 2, base_from_tcp @ TCP_FROM_GRASP
        grasp_from_base = inverse(base_from_grasp)
        near = [(body, moved(planes, corners, grasp_from_base)) for body, planes, corners in self._parts]
        left, right = self._contacts(near, half_m)
        if left is None or right is None:
            return 0.0, 0.0
        up_m = float(min(left.places[:, 2].max(), right.places[:, 2].max()))
        edge = inverse(self._table) @ base_from_grasp @ np.array([0.0, 0.0, up_m, 1.0])
        return up_m, float(edge[2])

    # --- closing -----------------------------------------------------------------------------------------------------

    def _closed(self, near: Sequence[tuple[int, Solid]], half_m: float) -> Verdict:
        left, right = self._contacts(near, half_m)
        if left is None or right is None:
            return Verdict(NOTHING, "nothing between the pads")
        start, end = float(left.places[:, 1].min()), float(right.places[:, 1].max())
        width_m = end - start
        bodies = sorted({*left.bodies.tolist(), *right.bodies.tolist()})
        if FIXED in bodies:
            return Verdict(COLLIDES, "a wall between the pads", None, width_m)
        if len(bodies) > 1:
            return Verdict(SEAM, f"bodies {bodies}", None, width_m)
        if width_m < _THINNEST_M or min(len(left.bodies), len(right.bodies)) < _LEAST_LINES:
            return Verdict(THIN, f"{len(left.bodies)} and {len(right.bodies)} lines", bodies[0], width_m)
        if abs(start + end) / 2 > _OFF_MIDDLE_M:
            return Verdict(OFF, f"{abs(start + end) * 500:.0f} mm off the middle", bodies[0], width_m)
        if not _holds(left, right):
            return Verdict(SLIPS, "no two contacts within both friction cones", bodies[0], width_m)
        return Verdict(TRUE, "", bodies[0], width_m)

    def _contacts(self, near: Sequence[tuple[int, Solid]], half_m: float) -> tuple[_Patch | None, _Patch | None]:
        """Return what the pads, from the left and from the right, meet first; None for nothing."""
        x_m, z_m = np.linspace(-_PAD_M / 2, _PAD_M / 2, _PAD_LINES), np.linspace(_LOW_M, _HIGH_M, _HIGH_LINES)
        x, z = (one.ravel() for one in np.meshgrid(x_m, z_m, indexing="ij"))
        lines = np.stack([x, np.zeros(x.size), z], axis=1)
        low, high = np.array([-_PAD_M / 2, -half_m, _LOW_M]), np.array([_PAD_M / 2, half_m, _HIGH_M])
        chords = [(body, solid.clip(lines, 1)) for body, solid in near if box_near(solid, low, high)]
        if not chords:
            return None, None
        bodies = np.array([body for body, _ in chords])
        entry, leave = np.array([one.entry for _, one in chords]), np.array([one.leave for _, one in chords])
        between = (entry < half_m) & (leave > -half_m)  # (parts, lines)
        if not between.any():
            return None, None
        left, right = np.where(between, entry, np.inf), np.where(between, leave, -np.inf)
        normals = (np.array([one.entry_normal for _, one in chords]), np.array([one.leave_normal for _, one in chords]))
        return _patch(left, 1.0, normals[0], bodies, lines), _patch(-right, -1.0, normals[1], bodies, lines)


def _patch(depth: Array, sign: float, normals: Array, bodies: npt.NDArray[np.int64], lines: Array) -> _Patch:
    """The first contacts: each line's first, of those within the rubber's yield of the very first.

    Args:
        depth: (parts, lines) how far a pad travels until it meets each part, from its own side.
        sign: of the closing axis for this pad.
    """
    part, line = depth.argmin(axis=0), np.arange(depth.shape[1])
    first = depth[part, line]
    kept = np.flatnonzero(first < first.min() + _RUBBER_M)
    places = lines[kept].copy()
    places[:, 1] = sign * first[kept]
    return _Patch(places, normals[part[kept], kept], bodies[part[kept]])


def _holds(left: _Patch, right: _Patch) -> bool:
    """Whether the line between some two contacts lies within the friction cones of both facets."""
    across = right.places[None] - left.places[:, None]
    across /= np.maximum(np.linalg.norm(across, axis=2, keepdims=True), 1e-9)
    inward = -(across * left.normals[:, None]).sum(axis=2)
    outward = (across * right.normals[None]).sum(axis=2)
    return bool((np.minimum(inward, outward) >= _CONE_COS).any())
