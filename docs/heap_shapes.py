"""Things to drop for the pictures of docs/method.md: boxes, cans, a mug. In metres."""

from __future__ import annotations

import numpy as np

from benchmarks.heaps.shapes import Shape, box

_SIDES = np.arange(20) * 2 * np.pi / 20


def prism(name: str, radius_m: float, height_m: float) -> Shape:
    """A can."""
    ring = radius_m * np.stack([np.cos(_SIDES), np.sin(_SIDES)], axis=1)
    ends = [np.column_stack([ring, np.full(len(ring), z)]) for z in (-height_m / 2, height_m / 2)]
    return Shape(name, (np.concatenate(ends),), 700.0)


def mug(radius_m: float = 0.038, height_m: float = 0.08, wall_m: float = 0.005) -> Shape:
    """A cup without a handle: a floor, and a wall of convex pieces."""
    parts = [prism("floor", radius_m, wall_m).parts[0] - [0.0, 0.0, (height_m - wall_m) / 2]]
    for turn in np.stack([_SIDES, _SIDES + _SIDES[1]], axis=1):
        edge = np.array([[r * np.cos(a), r * np.sin(a)] for a in turn for r in (radius_m - wall_m, radius_m)])
        parts.append(np.concatenate([np.column_stack([edge, np.full(4, z)]) for z in (-height_m / 2, height_m / 2)]))
    return Shape("mug", tuple(parts), 900.0)


HEAP = (
    box("brick", (0.03, 0.06, 0.045)), box("cube", (0.05, 0.05, 0.05)), box("slab", (0.04, 0.12, 0.03)),
    box("book", (0.025, 0.09, 0.06)), box("plank", (0.018, 0.16, 0.05)), prism("can", 0.03, 0.10),
    prism("tin", 0.035, 0.04), prism("stick", 0.012, 0.14), prism("disc", 0.04, 0.02), mug(),
)  # fmt: skip
WIDE, TALL = box("plate", (0.15, 0.12, 0.04)), box("crate", (0.20, 0.20, 0.20))
