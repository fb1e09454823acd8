"""Drops objects on one another, once: they touch, lean on and hide each other. Seeded, and at rest at the end."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from bus.errors import ConfigError
from drivers.sim.placing import Placing, park

_SPREADS, _DRAWS = (0.45, 0.85), (1, 8)
"""Shares of the pick region, about its middle, over which objects are dropped at first, and those that rolled away
again; and of how many drawn places the lowest is taken."""
_ABOVE_M = 0.01
_FALL_TICKS, _CALM_TICKS = 400, 250
_CALMS = 12
"""Times that all speeds are set to zero at most, until nothing moves any more: what rocks on an edge does so long."""
_ROUNDS = 30

Array = npt.NDArray[np.float64]


def heap(placings: Sequence[Placing], region_m: Array, rng: np.random.Generator, settle: Callable[[int], None]) -> None:
    """Drop every object of ``placings`` into the region, one after the other; again those that end outside of it.

    Args:
        region_m: (2, 2) lowest and highest corner in ``base``.
        rng: source of the random places and orientations.
        settle: lets so many ticks of simulated time pass.

    Raises:
        ConfigError: not all of them come to rest inside.
    """
    park(placings)
    lying: list[Placing] = []
    for number in range(_ROUNDS):
        for placing in placings:
            if placing not in lying:
                _drop(placing, lying, region_m, rng, again=number > 0)
                lying.append(placing)
                settle(_FALL_TICKS)
        _calm(lying, settle)
        lying = [placing for placing in placings if placing.rests_inside()]
        if len(lying) == len(placings):
            return
        park([placing for placing in placings if placing not in lying])
    raise ConfigError(
        f"Of {len(placings)} dropped objects only {len(lying)} come to rest in the pick region.",
        "Lower sim.clutter, enlarge scene.pick_region_m, or put walls around it (config/bin.toml).",
    )


def _drop(
    placing: Placing, lying: Sequence[Placing], region_m: Array, rng: np.random.Generator, *, again: bool
) -> None:
    """Put the object at a random place and orientation, just above all that lies there."""
    middle_m, half_m = region_m.mean(axis=0), np.ptp(region_m, axis=0) / 2
    wxyz = rng.standard_normal(4)
    wxyz /= np.linalg.norm(wxyz)
    boxes = [other.extent() for other in lying]
    drawn = []
    for _ in range(_DRAWS[again]):
        place_m = middle_m + _SPREADS[again] * half_m * rng.uniform(-1, 1, 2)
        placing.put(np.array([*place_m, 0.0]), wxyz)
        low, high = placing.extent()
        top_m = max((float(box[1, 2]) for box in boxes if _is_under(box, low, high)), default=0.0)
        drawn.append((top_m + _ABOVE_M - float(low[2]), *place_m.tolist()))
    z_m, x_m, y_m = min(drawn)
    placing.put(np.array([x_m, y_m, z_m]), wxyz)


def _is_under(box: Array, low: Array, high: Array) -> bool:
    return bool((box[0, :2] < high[:2]).all() and (box[1, :2] > low[:2]).all())


def _calm(lying: Sequence[Placing], settle: Callable[[int], None]) -> None:
    """Let time pass until nothing has moved twice in a row, as what balances falls late; or long enough."""
    still = 0
    for _ in range(_CALMS):
        settle(_CALM_TICKS)
        if not any(placing.is_moving() for placing in lying):
            still += 1
            if still == 2:
                return
            continue
        still = 0
        for placing in lying:
            placing.stop()
