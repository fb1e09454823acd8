"""The objects of a heap: those that the jaw could close on in some direction, and that lie flat there."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt

from benchmarks.held.solids import things
from config.schema import Station
from drivers.sim.mjcf import attach

_DIRECTIONS = 4000
_SLACK_M = 0.002
"""Room in the jaw below which nothing is held: it would have to be met exactly."""

Array = npt.NDArray[np.float64]


def why_not(file: Path, station: Station) -> str:
    """Return why no jaw can take the object of a file out of the station's pick region; "" when one could."""
    spec = mujoco.MjSpec()
    attach(spec, file, "object", in_parts=False)
    (thing,) = things(spec.compile(), {"object": file.stem})
    points = np.concatenate(thing.parts)
    narrowest_m, jaw_m = _narrowest_m(points), station.hand.max_width_m - _SLACK_M
    if narrowest_m > jaw_m and len(thing.parts) == 1:  # of several parts, one may be held
        return f"{narrowest_m * 1e3:.0f} mm wide in every direction, the jaw takes {jaw_m * 1e3:.0f}"
    x_min, x_max, y_min, y_max = station.scene.pick_region_m
    room_m, sides_m = sorted((x_max - x_min, y_max - y_min)), sorted(np.ptp(_turned(points), axis=0))[1:]
    if sides_m[0] > room_m[0] or sides_m[1] > room_m[1]:
        return f"{sides_m[0] * 1e3:.0f} x {sides_m[1] * 1e3:.0f} mm when it lies flat, more than the pick region"
    return ""


def _narrowest_m(points: Array) -> float:
    """Return the least distance between two parallel planes that hold points (n, 3) between them."""
    index = np.arange(_DIRECTIONS) + 0.5
    polar, turn = np.arccos(1 - index / _DIRECTIONS), np.pi * (1 + 5**0.5) * index  # half a sphere, evenly
    directions = np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)])
    return float(np.ptp(points @ directions, axis=0).min())


def _turned(points: Array) -> Array:
    """Return points (n, 3) along their principal axes."""
    middle = points - points.mean(axis=0)
    return np.asarray(middle @ np.linalg.svd(middle, full_matrices=False)[2].T)
