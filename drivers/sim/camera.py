"""The simulated Femto Mega on the wrist."""

from __future__ import annotations

import cv2
import mujoco
import numpy as np
import numpy.typing as npt

from bus.errors import DriverUnavailable, NotConnected
from bus.messages import Frame
from drivers.sim.optics import COLOR, COLOR_FROM_DEPTH, COLOR_PINHOLE, DEPTH, DEPTH_PINHOLE, Pinhole
from drivers.sim.scene import COLOR_CAMERA, DEPTH_CAMERA
from drivers.sim.sensor import sense
from drivers.sim.world import World

_COLOR_NOISE = 1.5


class SimCamera:
    """Renders colour and depth with MuJoCo and bends them into the Femto Mega's lenses.

    The graphics context belongs to the thread that calls `connect`; capture from the same one.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._renderers: tuple[mujoco.Renderer, mujoco.Renderer] | None = None
        self._model: mujoco.MjModel | None = None
        self._connected = False
        self._captures = 0

    def connect(self) -> None:
        """Open the graphics context. Raises: DriverUnavailable without EGL."""
        if not self._connected:
            self._open()
            self._connected = True

    def close(self) -> None:
        self._connected = False
        for renderer in self._renderers or ():
            renderer.close()
        self._renderers, self._model = None, None

    def capture(self) -> Frame:
        if not self._connected:
            raise NotConnected("The simulated camera is not connected.", "Call connect() first.")
        with self._world.lock:
            if self._model is not self._world.model:
                self._open()
            stamp_ns = self._world.clock_ns()
            color, depth_m = self._render()
            seeds = [self._world.station.sim.seed, self._world.presented, self._captures]
        self._captures += 1
        rng = np.random.default_rng(seeds)
        noisy = color + rng.normal(0.0, _COLOR_NOISE, color.shape)
        scale = self._world.station.sim.depth_noise
        return Frame(
            stamp_ns=stamp_ns,
            color=noisy.clip(0, 255).astype(np.uint8),
            depth_m=sense(depth_m, rng, self._world.station.sim.seed, scale),
            color_camera=COLOR,
            depth_camera=DEPTH,
            color_from_depth=COLOR_FROM_DEPTH,
        )

    def _open(self) -> None:
        for renderer in self._renderers or ():
            renderer.close()
        model = self._world.model
        try:
            color = mujoco.Renderer(model, COLOR_PINHOLE.height, COLOR_PINHOLE.width)
            depth = mujoco.Renderer(model, DEPTH_PINHOLE.height, DEPTH_PINHOLE.width)
        except (RuntimeError, ImportError, AttributeError, mujoco.FatalError) as error:
            raise DriverUnavailable(
                f"Cannot render without a display: {error}.",
                "Install EGL: apt-get install libegl1 libgl1-mesa-dri, and leave MUJOCO_GL unset or =egl.",
            ) from error
        depth.enable_depth_rendering()
        self._renderers, self._model = (color, depth), model

    def _render(self) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
        assert self._renderers is not None
        color, depth = self._renderers
        color.update_scene(self._world.data, COLOR_CAMERA)
        pixels = _bend(color.render(), COLOR_PINHOLE, cv2.INTER_LINEAR)
        depth.update_scene(self._world.data, DEPTH_CAMERA)
        return pixels, _bend(depth.render(), DEPTH_PINHOLE, cv2.INTER_NEAREST)


def _bend(image: npt.NDArray[np.generic], pinhole: Pinhole, interpolation: int) -> npt.NDArray[np.generic]:
    """The lens's image from the pinhole's."""
    return np.asarray(cv2.remap(image, pinhole.source_x, pinhole.source_y, interpolation))
