"""One finished scene: what the camera saw first, what is true, and its file in the cache. Frame: ``base``."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.heaps.drop import Dropped, drop
from benchmarks.heaps.picture import take
from benchmarks.heaps.plan import HEAPS, plan, station_of
from benchmarks.heaps.shapes import Shape, box_corners, read_shapes
from bus.messages import ArmMode, ArmState, Frame, Observation, View
from bus.transforms import apply
from config.scene import scene_boxes
from config.schema import Station
from drivers.sim.optics import COLOR, COLOR_FROM_DEPTH, DEPTH

FIXED = -1
"""Stands for the bin's walls and the tray among the bodies."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Part:
    """A convex part at rest.

    Attributes:
        corners: (k, 3) in ``base`` [m].
        body: index of its body in `Heap.names`, or `FIXED`.
    """

    corners: Array
    body: int


@dataclass(frozen=True)
class Look:
    """A further view of the same scene (`benchmarks.heaps.views`).

    Attributes:
        q_rad: (7,) of the arm. ``motion_s``: planned time to there, from the view before.
        color: (H, W, 3) RGB. ``depth_m``: (h, w), NaN = invalid.
        base_from_color: (4, 4) the camera's pose as the station has it; ``true_base_from_color`` as it is.
    """

    q_rad: Array
    motion_s: float
    color: npt.NDArray[np.uint8]
    depth_m: npt.NDArray[np.float32]
    base_from_color: Array
    true_base_from_color: Array


@dataclass(frozen=True)
class Heap:
    """A scene.

    Attributes:
        kind, pair: as `Plan`. ``names``: of the bodies.
        color: (H, W, 3) RGB. ``depth_m``: (h, w), NaN = invalid.
        base_from_color: (4, 4) the camera's pose as the station has it; ``true_base_from_color`` as it is.
        base_from_table: (4, 4) the table's true pose: its top is z = 0 of ``table``.
        parts: of all bodies, and of walls and tray.
        feasible: whether the oracle finds a robust grasp; None = it was not asked.
        set_name: as `Plan`. ``further``: the views after the first; empty until they are asked for.
    """

    n: int
    seed: int
    kind: str
    pair: str
    names: tuple[str, ...]
    color: npt.NDArray[np.uint8]
    depth_m: npt.NDArray[np.float32]
    base_from_color: Array
    true_base_from_color: Array
    base_from_table: Array
    parts: tuple[Part, ...]
    feasible: bool | None = None
    set_name: str = HEAPS
    further: tuple[Look, ...] = ()

    def station(self, overrides: tuple[str, ...] = ()) -> Station:
        """Return the station that picks here."""
        return station_of(self.kind, overrides)

    def observation(self) -> Observation:
        """Return what `perception.detector.detect` is given of the first view."""
        q_rad = np.array(station_of(self.kind).arm.capture_q_rad)
        return self._observed(0, Look(q_rad, 0.0, self.color, self.depth_m, self.base_from_color, np.eye(4)))

    def observations(self) -> tuple[Observation, ...]:
        """Return the first view's, then those of ``further``."""
        return self.observation(), *(self._observed(1 + index, look) for index, look in enumerate(self.further))

    def _observed(self, index: int, look: Look) -> Observation:
        stamp_ns, still = 1 + round(1e9 * (index + look.motion_s)), np.zeros(7)
        arm = ArmState(stamp_ns=stamp_ns, mode=ArmMode.IDLE, q_rad=look.q_rad, dq_rad_s=still, tau_ext_nm=still)
        frame = Frame(
            stamp_ns=stamp_ns,
            color=look.color,
            depth_m=look.depth_m,
            color_camera=COLOR,
            depth_camera=DEPTH,
            color_from_depth=COLOR_FROM_DEPTH,
        )
        return Observation(view=View(stamp_ns=stamp_ns, arm=arm, base_from_color=look.base_from_color), frame=frame)


def make(n: int, seed: int, shapes: Sequence[Shape], set_name: str = HEAPS) -> Heap:
    """Drop and photograph a heap. Raises: DriverError, DriverUnavailable."""
    drawn = plan(n, seed, set_name)
    dropped = drop(drawn, shapes)
    color, depth_m = take(dropped, drawn)
    parts = loose_parts(dropped, drawn.base_from_table)
    scene = station_of(drawn.kind).scene
    for one in scene_boxes(scene):
        if one.name != scene.table.name:  # that is a plane
            corners = box_corners(np.array(one.size_m), np.array(one.center_m))
            parts.append(Part(apply(drawn.base_from_table, corners), FIXED))
    return Heap(
        n, seed, drawn.kind, drawn.pair, tuple(shape.name for shape in dropped.bodies), color, depth_m,
        drawn.base_from_color, drawn.true_base_from_color, drawn.base_from_table, tuple(parts), set_name=set_name,
    )  # fmt: skip


def loose_parts(dropped: Dropped, base_from_table: Array) -> list[Part]:
    """Return the parts of all bodies at rest."""
    return [
        Part(apply(base_from_table @ pose, corners), body)
        for body, (shape, pose) in enumerate(zip(dropped.bodies, dropped.table_from_body, strict=True))
        for corners in shape.parts
    ]


def path_of(cache: Path, n: int, seed: int, set_name: str = HEAPS) -> Path:
    """Return the scene's file in the cache folder."""
    return cache / f"{f'n{n:02d}' if set_name == HEAPS else set_name}-seed{seed:05d}.npz"


def save(heap: Heap, cache: Path) -> None:
    """Write the scene into the cache folder, whole or not at all."""
    cache.mkdir(parents=True, exist_ok=True)
    write_arrays(
        path_of(cache, heap.n, heap.seed, heap.set_name),
        numbers=np.array([heap.n, heap.seed]),
        texts=np.array([heap.kind, heap.pair, *heap.names]),
        set_name=np.array(heap.set_name),
        color=heap.color,
        depth_m=heap.depth_m,
        poses=np.array([heap.base_from_color, heap.true_base_from_color, heap.base_from_table]),
        corners=np.concatenate([part.corners for part in heap.parts]),
        counts=np.array([len(part.corners) for part in heap.parts]),
        bodies=np.array([part.body for part in heap.parts]),
        region_m=np.array(station_of(heap.kind).scene.pick_region_m),
    )


def write_arrays(path: Path, **arrays: npt.NDArray[Any]) -> None:
    """Write a file of named arrays, whole or not at all."""
    partial = path.with_suffix(f".{os.getpid()}.partial.npz")
    np.savez_compressed(partial, allow_pickle=False, **arrays)
    partial.replace(path)


def load(path: Path) -> Heap:
    """Read a scene from the cache."""
    with np.load(path) as file:
        n, seed = (int(number) for number in file["numbers"][:2])
        kind, pair, *names = (str(text) for text in file["texts"])
        corners = np.split(file["corners"], np.cumsum(file["counts"])[:-1])
        parts = tuple(Part(one, int(body)) for one, body in zip(corners, file["bodies"], strict=True))
        given, truth, base_from_table = file["poses"]
        set_name = str(file["set_name"]) if "set_name" in file else HEAPS
        return Heap(
            n, seed, kind, pair, tuple(names), file["color"], file["depth_m"], given, truth, base_from_table, parts,
            set_name=set_name,
        )  # fmt: skip


def obtain(n: int, seed: int, objects: Path, cache: Path | None, set_name: str = HEAPS) -> Heap:
    """Return the scene from the cache, or make it and keep it there."""
    if cache is not None and (path := path_of(cache, n, seed, set_name)).exists():
        return load(path)
    heap = make(n, seed, shapes_of(set_name, objects), set_name)
    if cache is not None:
        save(heap, cache)
    return heap


def shapes_of(set_name: str, objects: Path) -> tuple[Shape, ...]:
    """Return what a set's scenes are drawn from; of the sets made in code nothing."""
    return read_shapes(objects) if set_name == HEAPS else ()
