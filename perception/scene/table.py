"""The table as it is seen: the plane of the pick region, and how far it is from where the station says. In ``base``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from bus.arrays import Transform
from bus.codes import Code
from bus.errors import CycleFailure
from bus.transforms import from_rotation, inverse
from config.schema import Station

_AROUND_M = 0.13
"""The table is looked for in the pick region and this far around it."""
_SEARCHED_M, _SEARCHED_SLOPE = 0.08, 0.27
"""Largest height above or below the station's table, and largest slope, of a plane that may be the table."""
_POINTS, _TRIPLES = 2500, 400
_INLIER_M = 0.004
_BELOW_M = (0.010, 0.08)
"""Points so far below a plane say that the plane is an object's upper side, not the table."""
_MIN_POINTS, _MIN_SHARE = 100, 0.04
_TRIMMED_M = (0.008, 0.006, 0.004, 0.004)
_ENOUGH = 0.9
"""A lower plane is the table when it has this share of the highest score, so that a flat box's lid is not."""

Array = npt.NDArray[np.float64]
Points = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Table:
    """The seen plane z = slope_x * x + slope_y * y + height_m of ``base``.

    Attributes:
        offset_m: its height over the station's table, at the middle of the pick region.
    """

    slope_x: float
    slope_y: float
    height_m: float
    offset_m: float

    @property
    def tilt_rad(self) -> float:
        """Angle between the plane and the table that the station describes, which is level."""
        return float(np.arctan(np.hypot(self.slope_x, self.slope_y)))

    @cached_property
    def base_from_table(self) -> Transform:
        """(4, 4): z along the plane's normal, x above or below that of ``base``, origin on the z axis of ``base``."""
        z = np.array([-self.slope_x, -self.slope_y, 1.0])
        x = np.array([1.0, 0.0, self.slope_x])
        z, x = z / np.linalg.norm(z), x / np.linalg.norm(x)
        return from_rotation(np.column_stack([x, np.cross(z, x), z]), (0.0, 0.0, self.height_m))

    @cached_property
    def table_from_base(self) -> Transform:
        """(4, 4), the inverse of `base_from_table`."""
        return inverse(self.base_from_table)


def find_table(points_base: Points, station: Station) -> Table:
    """Fit the table to the points (h, w, 3) [m] in ``base``, NaN = no depth.

    The plane with the most points wins, among planes from triples of points picked with a fixed seed; points below a
    plane count against it. Then it is fitted by trimmed least squares.

    Raises: CycleFailure: NO_TABLE when no plane near the station's table is seen; TOO_NEAR when things fill the view.
    """
    near = _near(points_base, station)
    if len(near) < _MIN_POINTS and _fills_view(points_base, station):
        raise CycleFailure(
            Code.TOO_NEAR,
            "What the camera sees rises above the table everywhere: it is too near, or larger than the view.",
        )
    if len(near) < _MIN_POINTS:
        raise _none(f"only {len(near)} points lie within {_SEARCHED_M * 1e3:.0f} mm of it", station)
    coefficients = _best_plane(near)
    if coefficients is None:
        raise _none("no plane there holds enough of the points", station)
    for trimmed_m in _TRIMMED_M:
        close = np.abs(near[:, 2] - _at(coefficients, near)) < trimmed_m
        design = np.column_stack([near[close, :2], np.ones(int(close.sum()))])
        coefficients = np.asarray(np.linalg.lstsq(design, near[close, 2], rcond=None)[0])
    x_min, x_max, y_min, y_max = station.scene.pick_region_m
    middle = np.array([[(x_min + x_max) / 2, (y_min + y_max) / 2]])
    offset_m = float(_at(coefficients, middle)[0]) - station.scene.table.top_m
    slope_x, slope_y, height_m = (float(value) for value in coefficients)
    return Table(slope_x, slope_y, height_m, offset_m)


def require_where_configured(table: Table, station: Station) -> None:
    """Refuse a table that lies too far from where the station says. Raises: CycleFailure(TABLE_MOVED)."""
    settings, tilt_deg = station.scene.table, float(np.degrees(table.tilt_rad))
    if abs(table.offset_m) * 1e3 > settings.tolerance_mm or tilt_deg > settings.tolerance_deg:
        raise CycleFailure(
            Code.TABLE_MOVED,
            f"The table is seen {table.offset_m * 1e3:+.0f} mm from where the station says, tilted by {tilt_deg:.1f}"
            f" deg; {settings.tolerance_mm:.0f} mm and {settings.tolerance_deg:.1f} deg are tolerated.",
        )


def _near(points_base: Points, station: Station) -> Array:
    """About `_POINTS` of the points (n, 3) that may be the table's, in and around the pick region if it is in view."""
    x_min, x_max, y_min, y_max = station.scene.pick_region_m
    coarse = points_base[::3, ::3].reshape(-1, 3)
    x, y, z = coarse.T
    inside = (x > x_min - _AROUND_M) & (x < x_max + _AROUND_M) & (y > y_min - _AROUND_M) & (y < y_max + _AROUND_M)
    level = np.abs(z - np.float32(station.scene.table.top_m)) < _SEARCHED_M
    in_view = np.count_nonzero(inside & level) >= _MIN_POINTS
    near = coarse[inside & level if in_view or np.isfinite(z[inside]).any() else level]
    return np.asarray(near[:: max(1, len(near) // _POINTS)], dtype=float)


def _fills_view(points_base: Points, station: Station) -> bool:
    """Whether most of what is seen above the pick region is higher than a table could be."""
    x_min, x_max, y_min, y_max = station.scene.pick_region_m
    x, y, z = points_base[::3, ::3].reshape(-1, 3).T
    inside = (x > x_min) & (x < x_max) & (y > y_min) & (y < y_max)
    return bool(inside.sum() >= _MIN_POINTS and (z[inside] > station.scene.table.top_m + _SEARCHED_M).mean() > 0.5)


def _best_plane(near: Array) -> Array | None:
    """Coefficients (3,) of the plane that most of the points (n, 3) support; None when none has enough of them."""
    planes = _planes(near)
    single = near.T.astype(np.float32)
    below_m = _at(planes.T[..., None].astype(np.float32), single[:, None]) - single[2]
    score = (np.abs(below_m) < _INLIER_M).sum(axis=1) - ((below_m > _BELOW_M[0]) & (below_m < _BELOW_M[1])).sum(axis=1)
    if not len(score) or score.max() < max(_MIN_SHARE * len(near), _MIN_POINTS / 3):
        return None
    good = np.flatnonzero(score >= _ENOUGH * score.max())
    middle = near[:, :2].mean(axis=0)[:, None]
    return np.asarray(planes[good[np.argmin(_at(planes[good].T, middle))]])


def _planes(near: Array) -> Array:
    """Planes (k, 3) through triples of the points (n, 3), none of them steep."""
    triples = near[np.random.default_rng(0).integers(len(near), size=(_TRIPLES, 3))]
    design = np.concatenate([triples[..., :2], np.ones((_TRIPLES, 3, 1))], axis=2)
    solvable = np.abs(np.linalg.det(design)) > 1e-3  # twice the triangle's area [m2]
    planes = np.linalg.solve(design[solvable], triples[solvable][..., 2:])[..., 0]
    return np.asarray(planes[np.hypot(planes[:, 0], planes[:, 1]) < _SEARCHED_SLOPE])


def _at(coefficients: Array | Points, points: Array | Points) -> Array | Points:
    """Heights of planes (3, ...) at points (n, 2 or 3) or their transpose (2 or 3, 1, n)."""
    x, y = (points[..., 0], points[..., 1]) if coefficients.ndim == 1 else (points[0], points[1])
    return np.asarray(coefficients[0] * x + coefficients[1] * y + coefficients[2])


def _none(why: str, station: Station) -> CycleFailure:
    top_mm = station.scene.table.top_m * 1e3
    return CycleFailure(
        Code.NO_TABLE, f"The camera sees no table at the height the station says (z = {top_mm:.0f} mm): {why}."
    )
