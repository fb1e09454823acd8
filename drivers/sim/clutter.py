"""Fills the pick region once with many objects: each at rest, wholly inside, and apart from the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull

from bus.errors import ConfigError, DriverError
from drivers.sim.placing import Placing, park

APART_M = 0.03
"""Free space between two objects' outlines: a finger (12 mm) fits in, and the depth image shows the table."""
_ARRANGEMENTS = 200
_DRAWS = 200

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Outline:
    """A convex outline seen from above: its corners (n, 2), and its edges' outward normals and offsets (m, 3)."""

    corners_m: Array
    edges: Array

    @classmethod
    def around(cls, points_m: Array) -> _Outline:
        """Return the convex outline of points (n, 2) [m]."""
        hull = ConvexHull(points_m)
        return cls(points_m[hull.vertices], np.unique(hull.equations, axis=0))

    def moved(self, heading_rad: float, to_m: Array) -> _Outline:
        """Return the outline turned about the origin, then shifted."""
        cosine, sine = np.cos(heading_rad), np.sin(heading_rad)
        turn = np.array([[cosine, sine], [-sine, cosine]])
        normals = self.edges[:, :2] @ turn
        return _Outline(self.corners_m @ turn + to_m, np.column_stack([normals, self.edges[:, 2] - normals @ to_m]))

    def gap_m(self, other: _Outline) -> float:
        """Return the width of the widest strip along an edge that separates the two; negative where they overlap."""
        return max(self._beyond_m(other), other._beyond_m(self))

    def _beyond_m(self, other: _Outline) -> float:
        """Return how far all of ``other`` lies beyond the edge that separates them best."""
        return float((other.corners_m @ self.edges[:, :2].T + self.edges[:, 2]).min(axis=0).max())


@dataclass(frozen=True)
class _Rest:
    """The resting pose of one object alone: its height and rotation, and its outline around its origin."""

    placing: Placing
    z_m: float
    wxyz: Array
    outline: _Outline


def fill(placings: Sequence[Placing], region_m: Array, rng: np.random.Generator, settle: Callable[[], None]) -> None:
    """Lay every object of ``placings`` into the region, at random places.

    Args:
        region_m: (2, 2) lowest and highest corner in ``base``.
        rng: source of the random places.
        settle: lets simulated time pass until every object rests.

    Raises:
        ConfigError: the objects do not fit.
        DriverError: the objects do not come to rest.
    """
    rests = [_rest_alone(placing, placings, settle) for placing in placings]
    rests.sort(key=lambda rest: -float(np.ptp(rest.outline.corners_m, axis=0).max()))
    fitted = False
    for _ in range(_ARRANGEMENTS):
        if not _arrange(rests, region_m, rng):
            continue
        fitted = True
        settle()
        if all(placing.rests_wholly_inside() for placing in placings) and least_gap_m(placings) > APART_M / 2:
            return
    if fitted:
        raise DriverError("The objects do not come to rest in the pick region.", "Do they roll?")
    raise ConfigError(
        f"{len(placings)} objects do not fit into the pick region.",
        "Lower sim.clutter, enlarge scene.pick_region_m, or let them lie on one another: sim.heaped = true.",
    )


def least_gap_m(placings: Sequence[Placing]) -> float:
    """Return the least free space between any two objects, seen from above; infinite for one object."""
    outlines = [_Outline.around(placing.outline()[:, :2]) for placing in placings]
    return min((a.gap_m(b) for index, a in enumerate(outlines) for b in outlines[:index]), default=float("inf"))


def _rest_alone(placing: Placing, every: Sequence[Placing], settle: Callable[[], None]) -> _Rest:
    """Let it come to rest in the middle of the pick region while the others are away. Raises: DriverError."""
    park(every)
    placing.stand(0.0)
    settle()
    if not placing.rests_inside():
        raise DriverError(
            f"The object {placing.body!r} does not come to rest in the pick region.", "Is it too big, or does it roll?"
        )
    pose = placing.pose()
    return _Rest(placing, float(pose[2]), pose[3:], _Outline.around(placing.outline()[:, :2] - pose[:2]))


def _arrange(rests: Sequence[_Rest], region_m: Array, rng: np.random.Generator) -> bool:
    """Draw a heading and a place for each, the longest first; False when there is no place for one."""
    taken: list[_Outline] = []
    for rest in rests:
        drawn = _place(rest.outline, taken, region_m, rng)
        if drawn is None:
            return False
        heading_rad, place_m, outline = drawn
        taken.append(outline)
        wxyz = np.zeros(4)
        mujoco.mju_mulQuat(wxyz, np.array([np.cos(heading_rad / 2), 0.0, 0.0, np.sin(heading_rad / 2)]), rest.wxyz)
        rest.placing.put(np.array([*place_m, rest.z_m]), wxyz)
    return True


def _place(
    outline: _Outline, taken: Sequence[_Outline], region_m: Array, rng: np.random.Generator
) -> tuple[float, Array, _Outline] | None:
    """Return a heading [rad] and a place (x, y) in the region, apart from ``taken``, and the outline there; or None."""
    for _ in range(_DRAWS):
        heading_rad, share = float(rng.uniform(-np.pi, np.pi)), rng.uniform(size=2)
        turned = outline.moved(heading_rad, np.zeros(2))
        first, last = region_m[0] - turned.corners_m.min(axis=0), region_m[1] - turned.corners_m.max(axis=0)
        if (first > last).any():
            continue
        place_m = first + share * (last - first)
        there = turned.moved(0.0, place_m)
        if all(there.gap_m(other) >= APART_M for other in taken):
            return heading_rad, place_m, there
    return None
