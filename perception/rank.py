"""From carried rods to 6-DoF grasps: snapped to the observed surface, checked, ranked. Top-down."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from bus.messages import Grasp
from config.schema import Station
from perception.antipodal import Closings, close
from perception.heightmap import HeightMap

_SNAP_M = np.array([0.0, -0.004, 0.004, -0.008, 0.008, -0.012, 0.012])
_SNAP_RAD = np.deg2rad([0.0, -6.0, 6.0, -12.0, 12.0])
_MOVE_PENALTY = 0.15
_PER_RUN = 4
_APART_M, _APART_RAD = 0.006, np.deg2rad(10.0)
"""Grasps of one run differ by at least one of these."""

Array = npt.NDArray[np.float64]


def grasps_of_rod(ends_base: Array, rectangle: int, heights: HeightMap, station: Station) -> list[Grasp]:
    """Top-down grasps along one carried rod, given by the ends (2, 3) [m] of its run through the object, in ``base``.

    A bounded search beside the rod (12 mm, 12 degrees) snaps it to the observed surface; the best few that differ are
    kept, so that planning can fall back on them. Nothing there -> no grasp.
    """
    closings = _snap(ends_base, heights, station)
    chosen: list[int] = []
    for index in np.argsort(-closings.score, kind="stable"):
        if len(chosen) == _PER_RUN or not np.isfinite(closings.score[index]):
            break
        if all(_differ(closings, int(index), other) for other in chosen):
            chosen.append(int(index))
    return [_grasp(closings, index, rectangle) for index in chosen]


def _differ(closings: Closings, one: int, other: int) -> bool:
    apart_m = float(np.linalg.norm(closings.center_m[one] - closings.center_m[other]))
    return apart_m > _APART_M or abs(float(closings.heading_rad[one] - closings.heading_rad[other])) > _APART_RAD


def rank(grasps: list[Grasp], station: Station) -> tuple[Grasp, ...]:
    """Best first; equal scores keep their order."""
    ordered = sorted(grasps, key=lambda grasp: -grasp.score)
    return tuple(ordered[: station.perception.max_grasps])


def _snap(ends_base: Array, heights: HeightMap, station: Station) -> Closings:
    along = ends_base[1] - ends_base[0]
    heading = float(np.arctan2(along[1], along[0]))
    width_m = float(np.hypot(along[0], along[1]))
    side_m, turn_rad = (grid.ravel() for grid in np.meshgrid(_SNAP_M, _SNAP_RAD, indexing="ij"))
    lateral = np.array([-np.sin(heading), np.cos(heading)])
    centers = ends_base.mean(axis=0)[:2] + side_m[:, None] * lateral
    closings = close(heights, centers, heading + turn_rad, np.full(len(side_m), width_m), station)
    moved = np.abs(side_m) / np.abs(_SNAP_M).max() + np.abs(turn_rad) / np.abs(_SNAP_RAD).max()
    score = closings.score - _MOVE_PENALTY * moved
    return replace(closings, score=score)


def _grasp(closings: Closings, index: int, rectangle: int) -> Grasp:
    """The closing as a pose: y along the closing axis, z down."""
    heading = closings.heading_rad[index]
    y, z = np.array([np.cos(heading), np.sin(heading), 0.0]), np.array([0.0, 0.0, -1.0])
    base_from_tcp = np.eye(4)
    base_from_tcp[:3, 0], base_from_tcp[:3, 1], base_from_tcp[:3, 2] = np.cross(y, z), y, z
    base_from_tcp[:3, 3] = [*closings.center_m[index], closings.tcp_m[index]]
    return Grasp(
        base_from_tcp=base_from_tcp,
        width_m=float(closings.width_m[index]),
        opening_m=float(closings.opening_m[index]),
        score=float(closings.score[index]),
        rectangle=rectangle,
    )
