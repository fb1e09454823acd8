"""A crop of the image around an object. Detection works on it, because it is a small part of the frame.

Pixels are (u, v) of the undistorted colour image; see docs/frames.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from bus.messages import CameraModel
from perception.geometry.depth import Rgbd

Mask = npt.NDArray[np.bool_]
ScalarT = TypeVar("ScalarT", bound=np.generic)


@dataclass(frozen=True)
class Crop:
    """A rectangle of pixels inside the image.

    Attributes:
        left, top: the first column and row [px]. ``right``, ``bottom``: one past the last.
    """

    left: int
    top: int
    right: int
    bottom: int

    @staticmethod
    def around(mask: Mask, margin_px: int) -> Crop:
        """Return the bounding box of ``mask`` (H, W), enlarged by ``margin_px`` and clipped to the image."""
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        window = slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)
        return Crop.enclosing(window, mask.shape, margin_px)

    @staticmethod
    def enclosing(window: tuple[slice, slice], shape: tuple[int, ...], margin_px: int) -> Crop:
        """A window of rows and columns, enlarged by ``margin_px`` and clipped to an image of this shape (H, W)."""
        rows, columns = window
        return Crop(
            max(0, columns.start - margin_px),
            max(0, rows.start - margin_px),
            min(shape[1], columns.stop + margin_px),
            min(shape[0], rows.stop + margin_px),
        )

    def of(self, image: npt.NDArray[ScalarT]) -> npt.NDArray[ScalarT]:
        """Return the cropped part of an image (H, W, ...), as a contiguous copy."""
        return np.ascontiguousarray(image[self.top : self.bottom, self.left : self.right])

    def rgbd(self, rgbd: Rgbd) -> Rgbd:
        """Return the cropped RGB-D image. The principal point moves with the crop, so lifted points are unchanged."""
        camera = rgbd.camera
        part = CameraModel(
            width=self.right - self.left,
            height=self.bottom - self.top,
            fx=camera.fx,
            fy=camera.fy,
            cx=camera.cx - self.left,
            cy=camera.cy - self.top,
        )
        return Rgbd(self.of(rgbd.color), self.of(rgbd.depth_m), part)

    def back(self, part: npt.NDArray[ScalarT], whole: npt.NDArray[ScalarT]) -> npt.NDArray[ScalarT]:
        """A copy of ``whole`` (H, W, ...) with this crop replaced by ``part``."""
        pasted = whole.copy()
        pasted[self.top : self.bottom, self.left : self.right] = part
        return pasted
