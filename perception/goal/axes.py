"""The axes along which the jaw could close on one thing, from the search over the whole scene. In ``base``."""

from __future__ import annotations

import numpy as np

from bus.arrays import Transform
from bus.transforms import apply
from perception.grasps.closing import Closings
from perception.observed_object import Axis

_MOST = 8
_INSIDE_M = 0.004
"""The axis runs at least so far below the edge: on the object, not above it."""


def axes_of(closings: Closings, instance: int, base_from_level: Transform) -> tuple[Axis, ...]:
    """Return the best distinct axes of one thing, the best first; ``base_from_level``: (4, 4) the closings' frame."""
    ours = closings.on(instance)
    return tuple(_axis(ours, index, base_from_level) for index in ours.distinct(_MOST))


def _axis(closings: Closings, index: int, base_from_level: Transform) -> Axis:
    heading, width_m = closings.heading_rad[index], closings.width_m[index]
    half = width_m / 2 * np.array([np.cos(heading), np.sin(heading), 0.0])
    level_m = max(min(closings.tcp_m[index], closings.edge_m[index] - _INSIDE_M), _INSIDE_M)
    center = np.append(closings.center_m[index], level_m)
    ends = apply(base_from_level, np.stack([center - half, center + half]))
    return Axis(ends, -base_from_level[:3, 2], float(closings.score[index]))
