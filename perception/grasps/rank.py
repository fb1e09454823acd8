"""Derives 6-DoF grasps from aligned rods: approach around the rod, snap to the surface, check, rank.

The *level* frame has its z axis along the approach, reversed; from above it is the frame of the seen table. Grasps are
given in ``base``. See docs/frames.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from bus.messages import Grasp, Instance
from bus.transforms import apply, from_rotation, inverse
from config.schema import Station
from perception.grasps.closing import WEIGHTS, Closings, close, weighted
from perception.grasps.faces import across_faces
from perception.grasps.search import tested
from perception.observed_object import ObservedObject
from perception.scene.heightmap import HeightMap

_SNAP_M = np.array([0.0, -0.004, 0.004, -0.008, 0.008, -0.012, 0.012])
_SNAP_RAD = np.deg2rad([0.0, -6.0, 6.0, -12.0, 12.0])
_SLICES = (1.0, 0.5)
"""Shares of the rod's height at which the object is looked for: a rod may lie on it instead of in it."""
_PER_RUN = 4
_TILTS_RAD = np.deg2rad([20.0, -20.0])
"""Approaches other than the vertical one, about the rod; used only where the vertical one yields no grasp."""
_FROM_ABOVE = float(np.cos(np.deg2rad(5)))
_WIDTH_APART_M = 0.010
_TESTED = 12
_WEIGHTS = {**WEIGHTS, "seen": 2.0, "unmoved": 1.0, "consistent": 0.4}
"""Besides the closing's own criteria: all of the object has depth and is in the image; the rod was hardly moved; the
measured width is the imagined one."""
_NEEDED = {"central": 0.4, "robust": 0.5, "patch": 0.42, "square": 0.4, "free": 0.5}
"""Criteria that nothing makes up for when they are less: held far beside its middle a thing turns out of the jaw; a
grasp that a small error spoils, touches with two rays of seven, or leans by most of what friction holds, slips; with
less than 3 mm beside each finger these may come down on the thing. Of 60 picks in simulated heaps with such a grasp 27
held, of 94 others 63 (without the last criterion)."""
_LACKING = 0.25
_CUT = 0.5
"""How much of an object that the image's border cuts counts as seen."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Rod:
    """A run of the aligned rod in the level frame: centre (x, y, z) [m], heading, width."""

    center_m: Array
    heading_rad: float
    width_m: float


def graded(closings: Closings, instances: tuple[Instance, ...]) -> Closings:
    """Return the closings, scored also by how completely the thing they hold was seen."""
    seen = np.array([1.0, *(one.depth_share * (1.0 if one.in_view else _CUT) for one in instances)])
    return _scored(closings, {**closings.terms, "seen": seen[closings.instance]})


def grasps_of_rod(
    ends_base: Array,
    rectangle: int,
    observed_object: ObservedObject,
    station: Station,
    approach_base: Array | None = None,
) -> list[Grasp]:
    """Grasps along one aligned rod, by the approach that is known, or else from above; if none is free, tilted.

    Args:
        ends_base: (2, 3) [m] ends of the rod's run through the object, in ``base``.
        rectangle: index of the run's rectangle.
        approach_base: (3,) the hand's way; None = not known.
    """
    scene = observed_object.scene
    base_from_table, grasps = scene.table.base_from_table, list[Grasp]()
    if approach_base is not None and -approach_base @ base_from_table[:3, 2] < _FROM_ABOVE:
        levels = [facing(ends_base, approach_base)]
    else:
        levels = [tilted(ends_base, float(tilt_rad), base_from_table) for tilt_rad in _TILTS_RAD]
        grasps = _approach(ends_base, rectangle, base_from_table, scene.heights, observed_object, station)
    for level in () if grasps else levels:
        heights, base_from_level = scene.along(level, observed_object.instance.number)
        grasps += _approach(ends_base, rectangle, base_from_level, heights, observed_object, station)
    return grasps


def rank(grasps: list[Grasp], station: Station) -> tuple[Grasp, ...]:
    """Return the best grasps, best first, at most ``perception.max_grasps``; equal scores keep their order."""
    ordered = sorted(grasps, key=lambda grasp: -grasp.score)
    return tuple(ordered[: station.perception.max_grasps])


def among_others(grasps: tuple[Grasp, ...], station: Station) -> tuple[Grasp, ...]:
    """Return the grasps of a thing among others, of which one may be taken first: what lacks the needed scores less."""
    lowered = [grasp.model_copy(update={"score": grasp.score * (1 - _LACKING * _lacking(grasp))}) for grasp in grasps]
    return rank(lowered, station)


def _lacking(grasp: Grasp) -> float:
    """0 where a grasp has all that is needed, 1 where it has nothing of one of it."""
    return max(0.0, *(1 - grasp.terms[name] / least for name, least in _NEEDED.items() if name in grasp.terms))


def pose(closings: Closings, index: int) -> Transform:
    """level_from_tcp (4, 4) of a closing: y along the closing axis, z down."""
    return _pose(closings.center_m[index], float(closings.heading_rad[index]), float(closings.tcp_m[index]))


def tilted(ends_base: Array, tilt_rad: float, base_from_table: Transform) -> Transform:
    """base_from_level (4, 4): origin on the table below the rod, z turned about the rod's heading."""
    ends = apply(inverse(base_from_table), ends_base)
    along = (ends[1] - ends[0]) * np.array([1.0, 1.0, 0.0])
    along = along / np.linalg.norm(along)
    across, up = np.array([-along[1], along[0], 0.0]), np.array([0.0, 0.0, 1.0])
    side = np.cos(tilt_rad) * across + np.sin(tilt_rad) * up
    normal = np.cos(tilt_rad) * up - np.sin(tilt_rad) * across
    x_m, y_m = ends.mean(axis=0)[:2]
    return np.asarray(base_from_table @ from_rotation(np.column_stack([along, side, normal]), (x_m, y_m, 0.0)))


def facing(ends_base: Array, approach_base: Array) -> Transform:
    """base_from_level (4, 4): x along the rod's ends (2, 3), z as nearly against an approach (3,) as that leaves it."""
    x = (ends_base[1] - ends_base[0]) / np.linalg.norm(ends_base[1] - ends_base[0])
    z = -approach_base + (approach_base @ x) * x
    z = z / np.linalg.norm(z)
    return from_rotation(np.column_stack([x, np.cross(z, x), z]), ends_base.mean(axis=0))


def _approach(
    ends_base: Array,
    rectangle: int,
    base_from_level: Transform,
    heights: HeightMap,
    observed_object: ObservedObject,
    station: Station,
) -> list[Grasp]:
    """The best few distinct grasps along the level frame's -z; planning uses the lower-ranked ones as fallbacks.

    A bounded search around the rod (12 mm, 12 degrees) snaps it to the observed surface.
    """
    ends = apply(inverse(base_from_level), ends_base)
    along = ends[1] - ends[0]
    heading, width_m = float(np.arctan2(along[1], along[0])), float(np.hypot(along[0], along[1]))
    rod = _Rod(ends.mean(axis=0), heading, width_m)
    snapped = _snap(rod, heights, station)
    imagined = base_from_level @ _pose(rod.center_m[:2], heading, float(snapped.tcp_m[0]))
    closings = _judged(_of(snapped, observed_object.instance.number), rod, heights, observed_object, station)
    closings = across_faces(closings, observed_object.scene, base_from_level)
    return [
        Grasp(
            base_from_tcp=base_from_level @ pose(closings, index),
            width_m=float(closings.width_m[index]),
            opening_m=float(closings.opening_m[index]),
            score=float(closings.score[index]),
            instance=observed_object.instance.number,
            rectangle=rectangle,
            imagined_base_from_tcp=imagined,
            terms={name: float(values[index]) for name, values in closings.terms.items()},
        )
        for index in closings.distinct(_PER_RUN)
    ]


def _of(closings: Closings, instance: int) -> Closings:
    """The closings, feasible only where they hold the instance."""
    return replace(closings, score=np.where(closings.instance == instance, closings.score, -np.inf))


def _snap(rod: _Rod, heights: HeightMap, station: Station) -> Closings:
    """Close the jaw on the rod and at offsets around it; the first candidate is the rod itself."""
    share, side_m, turn_rad = (
        grid.ravel() for grid in np.meshgrid(np.array(_SLICES), _SNAP_M, _SNAP_RAD, indexing="ij")
    )
    lateral = np.array([-np.sin(rod.heading_rad), np.cos(rod.heading_rad)])
    centers = rod.center_m[:2] + side_m[:, None] * lateral
    closings = close(heights, centers, rod.heading_rad + turn_rad, share * rod.center_m[2], station)
    moved = np.abs(side_m) / np.abs(_SNAP_M).max() + np.abs(turn_rad) / np.abs(_SNAP_RAD).max()
    return replace(closings, terms={**closings.terms, "unmoved": 1 - moved / 2})


def _judged(
    closings: Closings, rod: _Rod, heights: HeightMap, observed_object: ObservedObject, station: Station
) -> Closings:
    """The closings, scored also by the agreement of measured and imagined width, and by how they bear pose errors."""
    found = tested(closings, heights, station, _TESTED)
    apart = np.abs(closings.width_m - rod.width_m) / _WIDTH_APART_M
    found = graded(found, observed_object.instances)
    return _scored(found, {**found.terms, "consistent": 1 - np.minimum(apart, 1)})


def _scored(closings: Closings, terms: dict[str, Array]) -> Closings:
    score = np.where(np.isfinite(closings.score), weighted(terms, _WEIGHTS), -np.inf)
    return replace(closings, terms=terms, score=score)


def _pose(center_m: Array, heading_rad: float, tcp_m: float) -> Transform:
    y, z = np.array([np.cos(heading_rad), np.sin(heading_rad), 0.0]), np.array([0.0, 0.0, -1.0])
    return from_rotation(np.column_stack([np.cross(y, z), y, z]), [*center_m, tcp_m])
