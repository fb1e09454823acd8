"""Renders MuJoCo's cameras without a display, from any thread."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from bus.errors import DriverUnavailable
from drivers import egl

_MAX_GEOMS = 2000


class Painter:
    """One graphics context for one model.

    A context is current in at most one thread; here it is so only while drawing, so that any thread may draw next.

    Raises:
        DriverUnavailable: no graphics context is available here.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        size = model.vis.global_
        self._model = model
        try:
            self._gl = mujoco.GLContext(size.offwidth, size.offheight)
            with self._gl.as_current():
                self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
                mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        except (RuntimeError, ImportError, AttributeError, OSError, mujoco.FatalError) as error:
            raise DriverUnavailable(f"Nothing can be rendered here: {str(error).rstrip('.')}.", egl.advice()) from error
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        self._scene = mujoco.MjvScene(model, maxgeom=_MAX_GEOMS)
        self._options = mujoco.MjvOption()

    def look(self, data: mujoco.MjData, camera: str) -> None:
        """Take over the state of ``data`` and the pose of ``camera``."""
        view = mujoco.MjvCamera()
        view.type, view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, self._model.camera(camera).id
        mujoco.mjv_updateScene(
            self._model, data, self._options, None, view, mujoco.mjtCatBit.mjCAT_ALL.value, self._scene
        )

    def color(self, width: int, height: int) -> npt.NDArray[np.uint8]:
        """Return (height, width, 3) RGB."""
        pixels = np.empty((height, width, 3), np.uint8)
        self._draw(width, height, pixels, None)
        return pixels[::-1]

    def depth_m(self, width: int, height: int) -> npt.NDArray[np.float32]:
        """Return (height, width) distance along the optical axis."""
        buffer = np.empty((height, width), np.float32)
        self._draw(width, height, None, buffer)
        extent = self._model.stat.extent
        near, far = self._model.vis.map.znear * extent, self._model.vis.map.zfar * extent
        return np.asarray(near * far / (near + buffer[::-1] * (far - near)), np.float32)  # 1 at near, 0 at far

    def _draw(
        self,
        width: int,
        height: int,
        pixels: npt.NDArray[np.uint8] | None,
        depth: npt.NDArray[np.float32] | None,
    ) -> None:
        window = mujoco.MjrRect(0, 0, width, height)
        with self._gl.as_current():
            mujoco.mjr_render(window, self._scene, self._context)
            mujoco.mjr_readPixels(pixels, depth, window, self._context)

    def close(self) -> None:
        """Free the graphics context."""
        with self._gl.as_current():
            self._context.free()
        self._gl.free()
