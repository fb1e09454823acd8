"""The default scene of the camera stand-in: a static, tilted board with boxes on it."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from stand_ins.femto_mega.device import Exposure


def still(fps: float = 30.0) -> Iterator[Exposure]:
    """The same picture, ``fps`` times a second, for ever."""
    color, depth_mm = _color(), _depth_mm()
    due_s = time.monotonic()
    while True:
        yield Exposure(color, depth_mm, time.monotonic())
        due_s = max(due_s + 1 / fps, time.monotonic() - 1.0)
        time.sleep(max(0.0, due_s - time.monotonic()))


def _color() -> np.ndarray:
    v, u = np.mgrid[0:720, 0:1280]
    tiles = ((u // 80 + v // 80) % 2 * 90 + 80).astype(np.uint8)
    return np.stack([tiles, (u * 255 // 1280).astype(np.uint8), (v * 255 // 720).astype(np.uint8)], axis=-1)


def _depth_mm() -> np.ndarray:
    v, u = np.mgrid[0:576, 0:640]
    depth_mm: np.ndarray = 600.0 + 0.3 * v + 0.1 * u
    depth_mm[200:300, 250:380] -= 80
    depth_mm[350:420, 420:500] -= 120
    depth_mm[(u - 320) ** 2 / 320**2 + (v - 288) ** 2 / 288**2 > 1] = 0  # outside the illumination
    return depth_mm.astype(np.uint16)
