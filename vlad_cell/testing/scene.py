"""A small made-up scene: boxes on a table, seen from straight above."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bus.messages import CameraModel, Frame, Observation, View

CAMERA = CameraModel(width=480, height=360, fx=450.0, fy=450.0, cx=240.0, cy=180.0)
CAMERA_HEIGHT_M = 0.6
REGION = "scene.pick_region_m=[0.1, 0.8, -0.3, 0.3]"
"""The pick region in which the boxes stand, as an override of the station."""


class Box(NamedTuple):
    """Columns, rows, height [m], colour; a height of None = no depth there."""

    columns: tuple[int, int]
    rows: tuple[int, int]
    height_m: float | None
    rgb: tuple[int, int, int]


BAR = Box((80, 180), (100, 124), 0.03, (40, 90, 200))
"""127 x 30 mm: the jaw closes across its narrow side."""
PLATE = Box((240, 400), (180, 330), 0.02, (200, 60, 40))
"""206 x 193 mm: wider than the jaw."""


def seen(boxes: Sequence[Box]) -> Observation:
    """Return the observation of the boxes, with noise that is the same every time."""
    rng = np.random.default_rng(0)
    color = np.full((CAMERA.height, CAMERA.width, 3), 165.0)
    depth_m = np.full((CAMERA.height, CAMERA.width), CAMERA_HEIGHT_M)
    for box in boxes:
        part = np.s_[slice(*box.rows), slice(*box.columns)]
        color[part] = box.rgb
        depth_m[part] = np.nan if box.height_m is None else CAMERA_HEIGHT_M - box.height_m
    frame = Frame(
        stamp_ns=1,
        color=np.clip(color + rng.normal(0, 2, color.shape), 0, 255).astype(np.uint8),
        depth_m=(depth_m + rng.normal(0, 3e-4, depth_m.shape)).astype(np.float32),
        color_camera=CAMERA,
        depth_camera=CAMERA,
        color_from_depth=np.eye(4),
    )
    base_from_color = np.diag([1.0, -1.0, -1.0, 1.0])
    base_from_color[:3, 3] = [0.45, 0.0, CAMERA_HEIGHT_M]
    return Observation(view=View(stamp_ns=1, base_from_color=base_from_color), frame=frame)
