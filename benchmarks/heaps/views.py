"""Further views of a scene: rendered when they are asked for, and kept beside it in the cache. Frame: ``base``.

The camera is off in its mount: by the same transform, in its own frame, in every view.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.heaps.drop import Dropped, aim, drop
from benchmarks.heaps.heap import FIXED, Heap, Look, loose_parts, path_of, shapes_of, write_arrays
from benchmarks.heaps.picture import take
from benchmarks.heaps.plan import Plan, plan
from benchmarks.heaps.shapes import Shape
from benchmarks.heaps.viewpoints import Viewpoint, viewpoints
from bus.errors import DriverError
from bus.transforms import inverse

_SAME_M = 1e-6


def with_views(heap: Heap, objects: Path, cache: Path | None) -> Heap:
    """Return the scene with its further views, from the cache or rendered and kept there.

    Raises:
        DriverError: the kept scene was made by another version.
        DriverUnavailable: nothing can be rendered here.
    """
    kept = None if cache is None else path_of(cache, heap.n, heap.seed, heap.set_name).with_suffix(".views.npz")
    if kept is not None and kept.exists():
        return replace(heap, further=load(kept))
    seen = replace(heap, further=render(heap, shapes_of(heap.set_name, objects)))
    if kept is not None:
        save(seen, kept)
    return seen


def render(heap: Heap, shapes: Sequence[Shape]) -> tuple[Look, ...]:
    """Drop the scene again, and photograph it from every further viewpoint. Raises: as `with_views`."""
    drawn = plan(heap.n, heap.seed, heap.set_name)
    dropped = drop(drawn, shapes)
    _require_same(heap, dropped)
    nominal_from_true = inverse(heap.base_from_color) @ heap.true_base_from_color
    return tuple(
        _look(dropped, drawn, 1 + index, one, nominal_from_true) for index, one in enumerate(viewpoints(heap.kind))
    )


def _look(dropped: Dropped, drawn: Plan, index: int, viewpoint: Viewpoint, nominal_from_true: np.ndarray) -> Look:
    truth = viewpoint.base_from_color @ nominal_from_true
    aim(dropped, inverse(drawn.base_from_table) @ truth)
    color, depth_m = take(dropped, drawn, index)
    return Look(viewpoint.q_rad, viewpoint.motion_s, color, depth_m, viewpoint.base_from_color, truth)


def _require_same(heap: Heap, dropped: Dropped) -> None:
    """Raises: DriverError where things do not lie as they lay in the first view."""
    was = np.concatenate([part.corners for part in heap.parts if part.body != FIXED])
    now = np.concatenate([part.corners for part in loose_parts(dropped, heap.base_from_table)])
    if was.shape != now.shape or np.abs(was - now).max() > _SAME_M:
        raise DriverError(
            f"The scene n = {heap.n}, seed {heap.seed} falls otherwise than when it was kept.", "Delete its file."
        )


def save(heap: Heap, path: Path) -> None:
    """Write the further views, whole or not at all."""
    write_arrays(
        path,
        q_rad=np.array([look.q_rad for look in heap.further]),
        motion_s=np.array([look.motion_s for look in heap.further]),
        color=np.array([look.color for look in heap.further]),
        depth_m=np.array([look.depth_m for look in heap.further]),
        poses=np.array([(look.base_from_color, look.true_base_from_color) for look in heap.further]),
    )


def load(path: Path) -> tuple[Look, ...]:
    """Read what `save` wrote."""
    with np.load(path) as file:
        rows = zip(file["q_rad"], file["motion_s"], file["color"], file["depth_m"], file["poses"], strict=True)
        return tuple(
            Look(q_rad, float(motion_s), color, depth_m, *poses) for q_rad, motion_s, color, depth_m, poses in rows
        )
