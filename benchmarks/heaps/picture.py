"""The picture of a heap, as the simulated Femto Mega takes it: rendered, bent by its lenses, and noisy."""

from __future__ import annotations

from typing import TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from benchmarks.heaps.drop import Dropped
from benchmarks.heaps.plan import Plan
from drivers.sim.optics import COLOR_PINHOLE, DEPTH_PINHOLE, Pinhole
from drivers.sim.render import Painter
from drivers.sim.sensor import sense

_COLOR_NOISE = 1.5  # grey levels, as drivers/sim/camera.py
_DEPTH_NOISE = 1.0
_LOOKS = 10
"""The random numbers of further views are counted from here."""

PixelT = TypeVar("PixelT", np.uint8, np.float32)


def take(dropped: Dropped, plan: Plan, look: int = 0) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
    """Return colour (H, W, 3) RGB and depth (h, w) [m], NaN = invalid, from where the cameras are.

    Args:
        look: number of the view; each has its own noise.

    Raises:
        DriverUnavailable: nothing can be rendered here.
    """
    painter = Painter(dropped.model)
    try:
        painter.look(dropped.data, "color")
        pixels = painter.color(COLOR_PINHOLE.width, COLOR_PINHOLE.height)
        painter.look(dropped.data, "depth")
        depth_m = painter.depth_m(DEPTH_PINHOLE.width, DEPTH_PINHOLE.height)
    finally:
        painter.close()
    rng = plan.rng(_LOOKS + look if look else 3)
    color = _bent(pixels, COLOR_PINHOLE, cv2.INTER_LINEAR)
    noisy = (color + rng.normal(0.0, _COLOR_NOISE, color.shape)).clip(0, 255).astype(np.uint8)
    return noisy, sense(_bent(depth_m, DEPTH_PINHOLE, cv2.INTER_NEAREST), rng, plan.seed, _DEPTH_NOISE)


def _bent(image: npt.NDArray[PixelT], pinhole: Pinhole, interpolation: int) -> npt.NDArray[PixelT]:
    """Distort the pinhole's image into the lens's."""
    return np.asarray(cv2.remap(image, pinhole.source_x, pinhole.source_y, interpolation))
