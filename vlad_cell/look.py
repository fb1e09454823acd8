"""One capture of a recorded cycle as numpy."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from bus.messages import CameraModel, Observation
from perception.geometry.depth import Rgbd, register


@dataclass(frozen=True, eq=False)
class Look:
    """One capture: the colour image without the lens's distortion, and the depth brought into its pixels.

    Attributes:
        why: why the arm looked again from here; "" for the first look.
        base_from_camera: (4, 4) pose of the camera in ``base``, in metres; optical frame: x right, y down, z forward.
        stamp_ns: middle of the exposure, UTC.
        raw: the frame as the camera gave it, distorted, its depth in pixels of its own, with both cameras' models.
    """

    why: str
    base_from_camera: npt.NDArray[np.float64]
    stamp_ns: int
    raw: Observation

    def __repr__(self) -> str:
        height, width, _ = self.raw.frame.color.shape
        x_m, y_m, z_m = self.base_from_camera[:3, 3]
        why = f", {self.why}" if self.why else ""
        return f"Look of {width} x {height} px, from ({x_m:.3f}, {y_m:.3f}, {z_m:.3f}) m{why}"

    @property
    def color(self) -> npt.NDArray[np.uint8]:
        """(H, W, 3) uint8, RGB."""
        return self._rgbd.color

    @property
    def depth_m(self) -> npt.NDArray[np.float32]:
        """(H, W) float32, metres along the optical axis, NaN where nothing was measured."""
        return self._rgbd.depth_m

    @property
    def K(self) -> npt.NDArray[np.float64]:
        """(3, 3) intrinsics of both images, in pixels."""
        return _matrix(self._rgbd.camera)

    @cached_property
    def _rgbd(self) -> Rgbd:
        return register(self.raw.frame)


def look_of(seen: Observation) -> Look:
    """Return the look of an observation."""
    return Look(seen.view.why, seen.view.base_from_color, seen.view.stamp_ns, seen)


def _matrix(camera: CameraModel) -> npt.NDArray[np.float64]:
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
