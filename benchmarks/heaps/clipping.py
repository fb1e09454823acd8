"""Exact intersections of parallel lines with convex parts. Any frame; in metres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull

Array = npt.NDArray[np.float64]
_SAME = 6
"""Decimals to which the planes of two facets agree when they are one facet."""
_PARALLEL = 1e-9
_LEAST_M = 1e-6


@dataclass(frozen=True)
class Solid:
    """A convex part as half-spaces: normal . p + offset <= 0.

    Attributes:
        normals: (f, 3) outward unit normals. ``offsets``: (f,).
        low, high: (3,) corners of its box.
    """

    normals: Array
    offsets: Array
    low: Array
    high: Array

    def clip(self, origins: Array, axis: int) -> Chords:
        """Clip lines through ``origins`` (m, 3) along the frame's ``axis``, parametrised by that coordinate."""
        across = np.delete(np.arange(3), axis)
        value = self.normals[:, across] @ origins[:, across].T + self.offsets[:, None]  # (f, m) where the line is at 0
        rate = self.normals[:, axis]
        misses = (value[np.abs(rate) <= _PARALLEL] > 0).any(axis=0)
        into, out = np.flatnonzero(rate < -_PARALLEL), np.flatnonzero(rate > _PARALLEL)
        entries, exits = -value[into] / rate[into, None], -value[out] / rate[out, None]
        first, last = entries.argmax(axis=0), exits.argmin(axis=0)
        lines = np.arange(origins.shape[0])
        entry, leave = entries[first, lines], exits[last, lines]
        misses |= leave - entry < _LEAST_M
        entry, leave = np.where(misses, np.inf, entry), np.where(misses, -np.inf, leave)
        return Chords(entry, leave, self.normals[into[first]], self.normals[out[last]])


@dataclass(frozen=True)
class Chords:
    """The chords of m lines in a solid, from entry to leave; entry = inf, leave = -inf for those that miss it.

    Attributes:
        entry, leave: (m,). ``entry_normal``, ``leave_normal``: (m, 3) of the facets there.
    """

    entry: Array
    leave: Array
    entry_normal: Array
    leave_normal: Array


def half_spaces(corners: Array) -> Array:
    """Return (f, 4) half-spaces of the convex hull of ``corners`` (k, 3), facets in one plane merged."""
    equations = ConvexHull(corners).equations
    _, kept = np.unique(np.round(equations, _SAME), axis=0, return_index=True)
    return np.asarray(equations[np.sort(kept)])


def moved(planes: Array, corners: Array, frame_from_base: Array) -> Solid:
    """Return the solid of ``planes`` (f, 4) and ``corners`` (k, 3), both in ``base``, in another rigid frame."""
    turn, shift = frame_from_base[:3, :3], frame_from_base[:3, 3]
    normals, points = planes[:, :3] @ turn.T, corners @ turn.T + shift
    return Solid(normals, planes[:, 3] - normals @ shift, points.min(axis=0), points.max(axis=0))


def box_near(solid: Solid, low: Sequence[float] | Array, high: Sequence[float] | Array) -> bool:
    """Whether the solid's box meets the box from ``low`` to ``high``, each (3,)."""
    return bool((solid.low <= high).all() and (solid.high >= low).all())
