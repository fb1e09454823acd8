"""Fills the pick region once with many objects: each at rest, wholly inside, and a little apart from the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull

from bus.errors import ConfigError, DriverError
from drivers.sim.placing import Placing

APART_M = 0.03
"""Free space between two objects' outlines: a finger (12 mm) fits in, and the depth image shows the table."""
_ARRANGEMENTS = 100
_DRAWS = 60
_PARK_M = 5.0

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Rest:
    """How one object lies when it lies alone: its height and turn, and its outline around its origin (n, 2)."""

    placing: Placing
    z_m: float
    wxyz: Array
    outline_m: Array


def fill(placings: Sequence[Placing], region_m: Array, rng: np.random.Generator, settle: Callable[[], None]) -> None:
    """Lay every object of ``placings`` into ``region_m`` (2, 2: lowest and highest corner), drawn from ``rng``.

    Args:
        settle: lets time pass until what stands rests.

    Raises: ConfigError when they do not fit, DriverError when they do not rest.
    """
    rests = [_rest_alone(placing, placings, settle) for placing in placings]
    rests.sort(key=lambda rest: -float(np.ptp(rest.outline_m, axis=0).max()))
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
        "Lower sim.clutter, or enlarge scene.pick_region_m.",
    )


def least_gap_m(placings: Sequence[Placing]) -> float:
    """The least free space between any two objects, seen from above; infinite for one object."""
    hulls = [ConvexHull(placing.outline()[:, :2]) for placing in placings]
    return min((_gap_m(a, b) for index, a in enumerate(hulls) for b in hulls[:index]), default=float("inf"))


def _rest_alone(placing: Placing, every: Sequence[Placing], settle: Callable[[], None]) -> _Rest:
    """Let it come to rest in the middle of the pick region while the others are away."""
    for index, other in enumerate(every):
        other.put(np.array([0.0, 0.0, -_PARK_M * (1 + index)]), np.array([1.0, 0.0, 0.0, 0.0]))
    placing.stand(0.0)
    settle()
    if not placing.rests_inside():
        raise DriverError(
            f"The object {placing.body!r} does not come to rest in the pick region.", "Is it too big, or does it roll?"
        )
    pose = placing.pose()
    return _Rest(placing, float(pose[2]), pose[3:], placing.outline()[:, :2] - pose[:2])


def _arrange(rests: Sequence[_Rest], region_m: Array, rng: np.random.Generator) -> bool:
    """Draw a heading and a place for each, the longest first; False when one finds none."""
    taken: list[ConvexHull] = []
    for rest in rests:
        for _ in range(_DRAWS):
            heading_rad = rng.uniform(-np.pi, np.pi)
            cosine, sine = np.cos(heading_rad), np.sin(heading_rad)
            outline_m = rest.outline_m @ np.array([[cosine, sine], [-sine, cosine]])
            first, last = region_m[0] - outline_m.min(axis=0), region_m[1] - outline_m.max(axis=0)
            share = rng.uniform(size=2)
            if (first > last).any():
                continue
            place_m = first + share * (last - first)
            hull = ConvexHull(outline_m + place_m)
            if all(_gap_m(hull, other) >= APART_M for other in taken):
                break
        else:
            return False
        taken.append(hull)
        wxyz = np.zeros(4)
        mujoco.mju_mulQuat(wxyz, np.array([np.cos(heading_rad / 2), 0.0, 0.0, np.sin(heading_rad / 2)]), rest.wxyz)
        rest.placing.put(np.array([*place_m, rest.z_m]), wxyz)
    return True


def _gap_m(one: ConvexHull, other: ConvexHull) -> float:
    """Width of the widest strip along an edge of either that keeps the two apart; negative where they overlap."""
    return max(_beyond_m(one, other), _beyond_m(other, one))


def _beyond_m(one: ConvexHull, other: ConvexHull) -> float:
    """How far all of ``other`` lies beyond the edge of ``one`` that parts them best."""
    distance_m = other.points[other.vertices] @ one.equations[:, :2].T + one.equations[:, 2]
    return float(distance_m.min(axis=0).max())
