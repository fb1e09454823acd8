"""Single things that are hard from above: tall, hollow, or as wide as the jaw; made of convex parts. In metres.

Each is made as it stands: its z is up, and it is put down so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from benchmarks.heaps.plan import BOWLS, TALL, Plan
from benchmarks.heaps.shapes import Shape, box

_SIDES = 24
_TALL_M = (0.180, 0.220)
_BOTTLES, _LYING, _PLATES = 0.6, 0.25, 0.4
"""Shares: bottles and lying ones among the tall, plates among the bowls."""
_BOTTLE_RADIUS_M, _NECK_RADIUS_M = (0.022, 0.037), (0.010, 0.016)
_SHOULDER_FROM, _SHOULDER_TO = (0.55, 0.68), (0.72, 0.82)
"""Shares of a bottle's height."""
_TALL_SIDE_M, _TALL_DEPTH_M = (0.040, 0.075), (0.040, 0.110)
_DIAMETER_M, _WALL_M = (0.100, 0.250), (0.0025, 0.005)
_BOWL_HEIGHT_M, _PLATE_HEIGHT_M = (0.040, 0.090), (0.015, 0.030)
_WIDE_M, _HIGH_M, _DEEP_M = (0.090, 0.120), (0.030, 0.070), (0.030, 0.120)
_DENSITY_KG_M3, _HOLLOW_KG_M3 = (300.0, 1000.0), (500.0, 1500.0)

Array = npt.NDArray[np.float64]


def thing(plan: Plan) -> Shape:
    """Return the thing of a scene of a set, as drawn from its seed."""
    rng = plan.rng(6)
    if plan.set_name == TALL:
        return _tall(rng)
    return _hollow(rng) if plan.set_name == BOWLS else _wide(rng)


def _tall(rng: np.random.Generator) -> Shape:
    """A bottle or a box, standing, or now and then lying."""
    shape = _bottle(rng) if rng.uniform() < _BOTTLES else _tall_box(rng)
    if rng.uniform() >= _LYING:
        return shape
    down = Rotation.from_euler("x", 90, degrees=True)
    return replace(shape, parts=tuple(down.apply(part) for part in shape.parts))


def _bottle(rng: np.random.Generator) -> Shape:
    height, radius, neck = rng.uniform(*_TALL_M), rng.uniform(*_BOTTLE_RADIUS_M), rng.uniform(*_NECK_RADIUS_M)
    low, high = height * rng.uniform(*_SHOULDER_FROM), height * rng.uniform(*_SHOULDER_TO)
    rings = [(radius, 0.0), (radius, low), (neck, high), (neck, height)]
    parts = tuple(np.concatenate([_ring(*one), _ring(*two)]) for one, two in pairwise(rings))
    return Shape("bottle", parts, rng.uniform(*_DENSITY_KG_M3))


def _tall_box(rng: np.random.Generator) -> Shape:
    return _box("tall box", rng, _TALL_SIDE_M, _TALL_DEPTH_M, _TALL_M)


def _wide(rng: np.random.Generator) -> Shape:
    return _box("wide box", rng, _WIDE_M, _DEEP_M, _HIGH_M)


def _box(name: str, rng: np.random.Generator, *ranges_m: tuple[float, float]) -> Shape:
    x_m, y_m, z_m = (float(rng.uniform(*range_m)) for range_m in ranges_m)
    return replace(box(name, (x_m, y_m, z_m)), density_kg_m3=float(rng.uniform(*_DENSITY_KG_M3)))


def _hollow(rng: np.random.Generator) -> Shape:
    """A bowl, its wall in two tiers, or a plate with one."""
    radius, wall = rng.uniform(*_DIAMETER_M) / 2, rng.uniform(*_WALL_M)
    if rng.uniform() < _PLATES:
        name, profile = "plate", [(radius * rng.uniform(0.55, 0.75), 0.0), (radius, rng.uniform(*_PLATE_HEIGHT_M))]
    else:
        height, waist = min(rng.uniform(*_BOWL_HEIGHT_M), 1.2 * radius), rng.uniform(0.80, 0.96)
        name = "bowl"
        profile = [(radius * rng.uniform(0.4, 0.6), 0.0), (radius * waist, 0.45 * height), (radius, height)]
    foot = profile[0][0]
    floor = np.concatenate([_ring(foot, 0.0), _ring(foot, wall)])
    tiers = [_tier(one, two, wall) for one, two in pairwise(profile)]
    return Shape(name, (floor, *(part for tier in tiers for part in tier)), rng.uniform(*_HOLLOW_KG_M3))


def _tier(low: tuple[float, float], high: tuple[float, float], wall_m: float) -> list[Array]:
    """Return the wall's segments between two outer (radius, height), its thickness inwards."""
    ends = np.array([low, high])
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    inner = ends + wall_m * np.array([-along[1], along[0]])
    corners = np.concatenate([ends, inner])
    turns = 2 * np.pi * np.arange(_SIDES + 1) / _SIDES
    return [_around(corners, turns[side : side + 2]) for side in range(_SIDES)]


def _ring(radius_m: float, height_m: float) -> Array:
    return _around(np.array([[radius_m, height_m]]), 2 * np.pi * np.arange(_SIDES) / _SIDES)


def _around(profile: Array, turns_rad: Sequence[float] | Array) -> Array:
    """Return points (n, 3) of a profile (k, 2) of radii and heights, at each turn about z."""
    return np.concatenate(
        [np.column_stack([profile[:, :1] * (np.cos(a), np.sin(a)), profile[:, 1]]) for a in turns_rad]
    )
