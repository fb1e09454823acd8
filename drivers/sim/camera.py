"""The simulated Femto Mega on the wrist. Frames and images: docs/frames.md."""

from __future__ import annotations

import threading
from copy import copy
from typing import TypeVar

import cv2
import mujoco
import numpy as np
import numpy.typing as npt

from bus.errors import NotConnected
from bus.messages import Frame
from drivers.sim.optics import COLOR, COLOR_FROM_DEPTH, COLOR_PINHOLE, DEPTH, DEPTH_PINHOLE, Pinhole
from drivers.sim.render import Painter
from drivers.sim.scene import COLOR_CAMERA, DEPTH_CAMERA
from drivers.sim.sensor import sense
from drivers.sim.world import World

_COLOR_NOISE = 1.5  # grey levels

PixelT = TypeVar("PixelT", np.uint8, np.float32)


class SimCamera:
    """Renders colour and depth with MuJoCo and distorts them as the Femto Mega's lenses do. Any thread may capture.

    The noise of a frame depends only on ``sim.seed``, the seed of the presented object, and the number of frames
    captured of it before.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._painter: Painter | None = None
        self._model: mujoco.MjModel | None = None
        self._lock = threading.Lock()
        self._presentation = 0
        self._captures = 0

    def connect(self) -> None:
        """Open the graphics context. Raises: DriverUnavailable without one."""
        with self._lock:
            if self._painter is None:
                self._open(self._world.model)

    def close(self) -> None:
        """Close the graphics context; idempotent."""
        with self._lock:
            if self._painter is not None:
                self._painter.close()
            self._painter = self._model = None

    def capture(self) -> Frame:
        """Render one frame of the world as it is now, with noise. Raises: NotConnected."""
        with self._lock:
            if self._painter is None:
                raise NotConnected("The simulated camera is not connected.", "Call connect() first.")
            return self._capture()

    def _open(self, model: mujoco.MjModel) -> None:
        if self._painter is not None:
            self._painter.close()
        self._painter, self._model = None, None
        self._painter, self._model = Painter(model), model

    def _capture(self) -> Frame:
        sim = self._world.station.sim
        with self._world.lock:  # only for a copy: drawing takes a second, and arm and hand go on meanwhile
            model, data = self._world.model, copy(self._world.data)
            stamp_ns = self._world.clock_ns()
            if self._presentation != self._world.presentations:
                self._presentation, self._captures = self._world.presentations, 0
            rng = np.random.default_rng([sim.seed % 2**64, self._world.presented % 2**64, self._captures])
        if self._model is not model:
            self._open(model)
        color, depth_m = self._render(data)
        self._captures += 1
        noisy = color + rng.normal(0.0, _COLOR_NOISE, color.shape)
        return Frame(
            stamp_ns=stamp_ns,
            color=noisy.clip(0, 255).astype(np.uint8),
            depth_m=sense(depth_m, rng, sim.seed % 2**64, sim.depth_noise),
            color_camera=COLOR,
            depth_camera=DEPTH,
            color_from_depth=COLOR_FROM_DEPTH,
        )

    def _render(self, data: mujoco.MjData) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
        painter = self._painter
        assert painter is not None
        painter.look(data, COLOR_CAMERA)
        pixels = painter.color(COLOR_PINHOLE.width, COLOR_PINHOLE.height)
        painter.look(data, DEPTH_CAMERA)
        depth_m = painter.depth_m(DEPTH_PINHOLE.width, DEPTH_PINHOLE.height)
        return _bend(pixels, COLOR_PINHOLE, cv2.INTER_LINEAR), _bend(depth_m, DEPTH_PINHOLE, cv2.INTER_NEAREST)


def _bend(image: npt.NDArray[PixelT], pinhole: Pinhole, interpolation: int) -> npt.NDArray[PixelT]:
    """Distort the pinhole's image into the lens's."""
    return np.asarray(cv2.remap(image, pinhole.source_x, pinhole.source_y, interpolation))
