"""Checks joint lines for collisions as rarely as is safe: between two checks no point may move farther than is free."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from bus.arrays import Joints, JointSamples
from bus.cancel import Cancel
from planning.travel import Travel, sweep_m
from planning.world import Collision, World

Array = npt.NDArray[np.float64]

_STEP_M = 0.003
_RESIDUAL_M = 0.0025
WIDE_MARGINS_M = (0.025, 0.010)
"""Where nothing is within one of these, no finer check is needed until a point of the robot has moved so far."""
_HALF_M = (*(margin - _RESIDUAL_M for margin in WIDE_MARGINS_M), _STEP_M / 2)
"""How far any point may have moved from the configuration that is checked with each margin, the finest last."""
_PARTS = tuple(int(np.ceil(wide / fine - 1e-9)) for wide, fine in pairwise(_HALF_M))


def first_collision(world: World, path_rad: JointSamples, width_m: float, cancel: Cancel) -> Collision | None:
    """Return the first collision on the polyline ``path_rad`` (m, n), or None. See `Scene.first_collision`."""
    travel_m = sweep_m(world.robot, path_rad)
    blocks = max(1, int(np.ceil(travel_m[-1] / (2 * _HALF_M[0]))))
    edges = np.linspace(0.0, travel_m[-1], blocks + 1)
    middles = _at(path_rad, travel_m, (edges[1:] + edges[:-1]) / 2)
    for begin, end, middle in zip(edges[:-1], edges[1:], middles, strict=True):
        cancel.raise_if_set("plan")
        if world.collision(middle, width_m, wide=0) is None:
            continue
        checks = int(np.ceil((end - begin) / _STEP_M)) + 1
        for q in _at(path_rad, travel_m, np.linspace(begin, end, checks)):
            collision = world.collision(q, width_m)
            if collision is not None:
                return collision
    return None


def is_free(world: World, travel: Travel, q_from_rad: Joints, q_to_rad: Joints, width_m: float) -> bool:
    """Whether the straight joint line between two configurations (n,) is free. See `Scene.is_line_free`."""
    if any(world.collision(q, width_m) is not None for q in (q_to_rad, q_from_rad, (q_from_rad + q_to_rad) / 2)):
        return False
    moved_m = travel.along(q_from_rad, q_to_rad)
    shares = np.linspace(0.0, 1.0, len(moved_m))
    blocks = max(1, int(np.ceil(moved_m[-1] / (2 * _HALF_M[0]))))
    half_m = moved_m[-1] / (2 * blocks)
    middles_m = (2 * _spread(blocks) + 1) * half_m
    for wide, parts in enumerate(_PARTS):
        near_m = []
        for middle_m, share in zip(middles_m, np.interp(middles_m, moved_m, shares), strict=True):
            q = q_from_rad + share * (q_to_rad - q_from_rad)
            if world.collision(q, width_m, wide=wide) is not None:
                if world.collision(q, width_m) is not None:
                    return False
                near_m.append(middle_m)
        half_m /= parts
        middles_m = (np.array(near_m)[:, None] + half_m * np.arange(1 - parts, parts, 2)).ravel()
    shares = np.interp(middles_m, moved_m, shares)
    return all(world.collision(q_from_rad + t * (q_to_rad - q_from_rad), width_m) is None for t in shares)


@cache
def _spread(count: int) -> npt.NDArray[np.int_]:
    """Return the numbers 0 to ``count`` - 1 so that each is far from those before: a collision is found early."""
    bits = max(1, (count - 1).bit_length())
    return np.array(sorted(range(count), key=lambda number: f"{number:0{bits}b}"[::-1]))


def _at(path_rad: JointSamples, travel_m: Array, at_m: Array) -> JointSamples:
    return np.stack([np.interp(at_m, travel_m, column) for column in path_rad.T], axis=1)
