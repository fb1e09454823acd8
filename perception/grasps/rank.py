"""Derives 6-DoF grasps from aligned rods: approach around the rod, snap to the surface, check, rank.

The *level* frame has its z axis along the approach, reversed, and its origin on the table; grasps are given in
``base``. See docs/frames.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from bus.messages import Grasp
from bus.transforms import apply, from_rotation, inverse
from config.schema import Station
from perception.grasps.antipodal import WEIGHTS, Closings, close, weighted
from perception.observed_object import ObservedObject
from perception.scene.heightmap import HeightMap, height_map

_SNAP_M = np.array([0.0, -0.004, 0.004, -0.008, 0.008, -0.012, 0.012])
_SNAP_RAD = np.deg2rad([0.0, -6.0, 6.0, -12.0, 12.0])
_PER_RUN = 4
_TILTS_RAD = np.deg2rad([20.0, -20.0])
"""Approaches other than the vertical one, about the rod; used only where the vertical one yields no grasp."""
_WIDTH_APART_M = 0.010
_TESTED = 12
"""Number of best grasps that are tested against pose errors; the others count as surviving none."""
_ERRORS = np.array([[0.003, 0, 0], [-0.003, 0, 0], [0, 0.004, 0], [0, -0.004, 0], [0, 0, 0.087], [0, 0, -0.087]])
"""Pose errors that a grasp should survive: along and across the closing axis [m], and of the heading [rad]."""
_WEIGHTS = {**WEIGHTS, "unmoved": 0.30, "consistent": 0.10, "robust": 0.15}

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Rod:
    """A run of the aligned rod in the level frame: centre (x, y) [m], heading, width."""

    center_m: Array
    heading_rad: float
    width_m: float


def grasps_of_rod(ends_base: Array, rectangle: int, observed_object: ObservedObject, station: Station) -> list[Grasp]:
    """Grasps along one aligned rod, from above; if none is feasible, tilted about the rod by 20 degrees either way.

    Args:
        ends_base: (2, 3) [m] ends of the rod's run through the object, in ``base``.
        rectangle: index of the run's rectangle.
    """
    grasps = _approach(ends_base, rectangle, np.eye(4), observed_object.heights, station)
    for tilt_rad in () if grasps else _TILTS_RAD:
        base_from_level = _tilted(ends_base, float(tilt_rad))
        level_heights = height_map(observed_object.scene, inverse(base_from_level))
        grasps += _approach(ends_base, rectangle, base_from_level, level_heights, station)
    return grasps


def rank(grasps: list[Grasp], station: Station) -> tuple[Grasp, ...]:
    """The best grasps, best first, at most ``perception.max_grasps``; equal scores keep their order."""
    ordered = sorted(grasps, key=lambda grasp: -grasp.score)
    return tuple(ordered[: station.perception.max_grasps])


def _approach(
    ends_base: Array, rectangle: int, base_from_level: Transform, heights: HeightMap, station: Station
) -> list[Grasp]:
    """The best few distinct grasps along the level frame's -z; planning uses the lower-ranked ones as fallbacks.

    A bounded search around the rod (12 mm, 12 degrees) snaps it to the observed surface.
    """
    ends = apply(inverse(base_from_level), ends_base)
    along = ends[1] - ends[0]
    heading, width_m = float(np.arctan2(along[1], along[0])), float(np.hypot(along[0], along[1]))
    rod = _Rod(ends.mean(axis=0)[:2], heading, width_m)
    closings = _judged(_snap(rod, heights, station), rod, heights, station)
    imagined = base_from_level @ _pose(rod.center_m, heading, float(closings.tcp_m[0]))
    return [
        Grasp(
            base_from_tcp=base_from_level
            @ _pose(closings.center_m[index], float(closings.heading_rad[index]), float(closings.tcp_m[index])),
            width_m=float(closings.width_m[index]),
            opening_m=float(closings.opening_m[index]),
            score=float(closings.score[index]),
            rectangle=rectangle,
            imagined_base_from_tcp=imagined,
            terms={name: float(values[index]) for name, values in closings.terms.items()},
        )
        for index in closings.distinct(_PER_RUN)
    ]


def _snap(rod: _Rod, heights: HeightMap, station: Station) -> Closings:
    """Close the jaw on the rod and at offsets around it; the first candidate is the rod itself."""
    side_m, turn_rad = (grid.ravel() for grid in np.meshgrid(_SNAP_M, _SNAP_RAD, indexing="ij"))
    lateral = np.array([-np.sin(rod.heading_rad), np.cos(rod.heading_rad)])
    centers = rod.center_m + side_m[:, None] * lateral
    widths = np.full(len(side_m), rod.width_m)
    closings = close(heights, centers, rod.heading_rad + turn_rad, widths, station)
    moved = np.abs(side_m) / np.abs(_SNAP_M).max() + np.abs(turn_rad) / np.abs(_SNAP_RAD).max()
    return replace(closings, terms={**closings.terms, "unmoved": 1 - moved / 2})


def _judged(closings: Closings, rod: _Rod, heights: HeightMap, station: Station) -> Closings:
    """The closings, scored also by agreement of measured and imagined width, and by robustness to pose errors."""
    apart = np.abs(closings.width_m - rod.width_m) / _WIDTH_APART_M
    feasible = np.argsort(-closings.score, kind="stable")[: min(_TESTED, int(np.isfinite(closings.score).sum()))]
    robust = np.zeros(len(closings.score))
    robust[feasible] = _survived(closings, feasible, heights, station)
    terms = {**closings.terms, "consistent": 1 - np.minimum(apart, 1), "robust": robust}
    score = np.where(np.isfinite(closings.score), weighted(terms, _WEIGHTS), -np.inf)
    return replace(closings, terms=terms, score=score)


def _survived(closings: Closings, chosen: npt.NDArray[np.intp], heights: HeightMap, station: Station) -> Array:
    """Share (n,) of the pose errors after which the jaw still closes."""
    heading = closings.heading_rad[chosen]
    along = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    centers = closings.center_m[chosen, None] + _ERRORS[:, :1] * along[:, None] + _ERRORS[:, 1:2] * across[:, None]
    headings = heading[:, None] + _ERRORS[:, 2]
    widths = np.repeat(closings.width_m[chosen], len(_ERRORS))
    erred = close(heights, centers.reshape(-1, 2), headings.ravel(), widths, station)
    return np.asarray(np.isfinite(erred.score).reshape(len(chosen), len(_ERRORS)).mean(axis=1))


def _tilted(ends_base: Array, tilt_rad: float) -> Transform:
    """base_from_level (4, 4): origin on the table below the rod, z turned about the rod's heading."""
    along = (ends_base[1] - ends_base[0]) * np.array([1.0, 1.0, 0.0])
    along = along / np.linalg.norm(along)
    across, up = np.array([-along[1], along[0], 0.0]), np.array([0.0, 0.0, 1.0])
    side = np.cos(tilt_rad) * across + np.sin(tilt_rad) * up
    normal = np.cos(tilt_rad) * up - np.sin(tilt_rad) * across
    x_m, y_m = ends_base.mean(axis=0)[:2]
    return from_rotation(np.column_stack([along, side, normal]), (x_m, y_m, 0.0))


def _pose(center_m: Array, heading_rad: float, tcp_m: float) -> Transform:
    """level_from_tcp (4, 4): y along the closing axis, z down."""
    y, z = np.array([np.cos(heading_rad), np.sin(heading_rad), 0.0]), np.array([0.0, 0.0, -1.0])
    return from_rotation(np.column_stack([np.cross(y, z), y, z]), [*center_m, tcp_m])
