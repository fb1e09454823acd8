"""Checks that the camera of an image can see the table from where its pose puts it: else the pose is another one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bus.errors import BadFrame
from bus.messages import Observation
from bus.transforms import apply, inverse
from config.schema import Station
from perception.geometry.lift import lift_pixels

Array = npt.NDArray[np.float64]

_POINTS = 20_000
_AROUND_M, _LEVEL_M = 0.13, 0.08
"""Points so far around the pick region, and so near to the table's height, may be the table's (`find_table`)."""
_NONE, _FITS, _FAR_MORE = 0.02, 0.2, 2.0
"""Shares of the measured points that are the table's: of a pose that cannot be, and of another that may be meant; and
how many times more these are where the given pose cannot be ruled out."""
_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
_MEANT = (
    ("Is it camera_from_base? Its inverse would do: pass np.linalg.inv(base_from_camera).", inverse),
    (
        "Is y up in its camera, as in OpenGL? Turned about x it would do: pass base_from_camera @"
        " np.diag([1, -1, -1, 1]).",
        lambda pose: pose @ _OPENGL,
    ),
    (
        "Is it camera_from_base with y up, as in OpenGL? Pass np.linalg.inv(base_from_camera) @"
        " np.diag([1, -1, -1, 1]).",
        lambda pose: inverse(pose) @ _OPENGL,
    ),
)


class _Placed(NamedTuple):
    """The measured points (n, 3) in ``base``, and the camera there (3,), as a pose puts them."""

    points: Array
    camera: Array

    @classmethod
    def of(cls, points_camera: Array, base_from_camera: Array) -> _Placed:
        return cls(apply(base_from_camera, points_camera), base_from_camera[:3, 3])

    def above_region(self, station: Station, around_m: float = 0.0) -> npt.NDArray[np.bool_]:
        """Return which points (n,) lie above or below the pick region."""
        x_min, x_max, y_min, y_max = station.scene.pick_region_m
        x, y, _ = self.points.T
        in_x = (x > x_min - around_m) & (x < x_max + around_m)
        return np.asarray(in_x & (y > y_min - around_m) & (y < y_max + around_m))

    def on_table(self, station: Station) -> float:
        """The share of the points that may be the table's, or stand on it; 0 where the camera is below it."""
        top_m = station.scene.table.top_m
        near = np.abs(self.points[:, 2] - top_m) < _LEVEL_M
        return float((near & self.above_region(station, _AROUND_M)).mean()) if self.camera[2] > top_m else 0.0


def require_in_view(observation: Observation, station: Station) -> None:
    """Refuse a pose from which what was measured cannot be the table with what stands on it.

    Raises: BadFrame about ``base_from_camera``: where it puts the camera and the points, and what may be meant.
    """
    points_camera, pose = _measured(observation), observation.view.base_from_color
    placed = _Placed.of(points_camera, pose)
    share, meant = placed.on_table(station), _meant(points_camera, pose, station, _FITS)
    wrong = _wrong(placed, station)
    if not wrong and (share > _NONE or not meant):
        return
    wrong = wrong or f"only {share:.0%} of what was measured may be the table's"
    raise BadFrame(f"As base_from_camera has it, {wrong}.", " ".join((*meant[:1], _asked(placed, station))))


def another_meant(observation: Observation, station: Station) -> str:
    """Return which other pose would put far more of what was measured onto the table, as advice; "" for none."""
    points_camera, pose = _measured(observation), observation.view.base_from_color
    share = _Placed.of(points_camera, pose).on_table(station)
    return next(iter(_meant(points_camera, pose, station, max(_FITS, _FAR_MORE * share))), "")


def _meant(points_camera: Array, pose: Array, station: Station, share: float) -> list[str]:
    """Return what may be meant: poses for which more than ``share`` of the points may be the table's."""
    return [words for words, other in _MEANT if _Placed.of(points_camera, other(pose)).on_table(station) > share]


def _measured(observation: Observation) -> Array:
    """Some of the measured points (n, 3) in the camera; without the lens's distortion, which does not matter here."""
    depth_m, camera = observation.frame.depth_m, observation.frame.color_camera
    step = max(1, int(np.sqrt(depth_m.size / _POINTS)))
    v, u = np.nonzero(np.isfinite(depth_m[::step, ::step]))
    pixels = np.stack([u, v], axis=1).astype(float) * step
    return lift_pixels(pixels, depth_m[::step, ::step][v, u].astype(float), camera)


def _wrong(placed: _Placed, station: Station) -> str:
    """Return why the camera cannot see the table from there, in words; "" when it may."""
    top_m, heights_m = station.scene.table.top_m, placed.points[:, 2]
    if placed.camera[2] <= top_m:
        return f"the camera is at z = {placed.camera[2]:.3f} m, not above the table at z = {top_m:.3f} m"
    if heights_m.min() > placed.camera[2]:
        return "the camera looks up: all that was measured is higher than the camera itself"
    there = placed.above_region(station)
    if not there.any():
        return f"nothing of the pick region is in the picture: the points lie at {_extent(placed.points)}"
    low_m, high_m = top_m - _LEVEL_M, top_m + station.scene.max_height_m
    if (heights_m[there] < low_m).all() or (heights_m[there] > high_m).all():
        side, middle_m = "below" if heights_m[there].max() < top_m else "far above", float(np.median(heights_m[there]))
        return f"what is seen in the pick region lies at z = {middle_m:.3f} m, {side} the table at z = {top_m:.3f} m"
    return ""


def _asked(placed: _Placed, station: Station) -> str:
    x_min, x_max, y_min, y_max = station.scene.pick_region_m
    region = f"x {x_min:g} to {x_max:g}, y {y_min:g} to {y_max:g} m"
    if placed.camera[2] > station.scene.table.top_m and not placed.above_region(station).any():
        return f"If it is right: give region_m, where the objects lie in base (now {region})."
    top_m = station.scene.table.top_m
    return f"It is the pose of the camera in base, in metres; the table's top is at z = {top_m:g} there (scene.table)."


def _extent(points: Array) -> str:
    """Return where most of the points (n, 3) lie, in words."""
    low, high = np.percentile(points, (5, 95), axis=0)
    return ", ".join(f"{axis} {low[i]:z.2f} to {high[i]:z.2f}" for i, axis in enumerate("xyz")) + " m"
