"""Grasp networks of the GG-CNN family (GG-CNN, GR-ConvNet and similar) through ONNX: an image in, four maps out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from bus.errors import ConfigError
from bus.messages import Rectangle
from perception.onnx_session import OnnxSession

_WIDTH_PX = 150.0
"""Width in network pixels of a width map's value 1 (Morrison et al. 2018, Kumra et al. 2020)."""
_HEIGHT_SHARE = 0.5
_SMOOTHING_PX = 2.0
_ROOM = 1.25
"""Side of the square over the larger extent of objects that are too large for the network's own size."""
_SOURCE = "Name its .onnx file: perception.onnx.path."
_NEEDED = "Needed: (1, 1|3|4, S, S) float32 -> four maps (1, 1, S, S)."
_CHANNELS = {1: "depth", 3: "colour", 4: "depth and colour"}

Array = npt.NDArray[np.float32]


class GraspNetwork:
    """A grasp network, defined by its tensors and independent of its training framework.

    Input: (1, C, S, S) float32. C = 1: depth; 3: RGB; 4: depth, then RGB. Depth is in metres less its mean, clipped to
    +-1; RGB is in 0..1 less its mean. Outputs: four maps (1, 1, S, S), in this order: quality, cos 2a, sin 2a, width.
    a is the closing axis' angle counter-clockwise (image v points down, so it is negated here); width is in units of
    150 px. The rectangle is half as high as wide, the family's convention.

    Args:
        path: the ``.onnx`` file.

    Raises: ConfigError for a missing package, a file that is not such a network, or other tensors.
    """

    def __init__(self, path: Path) -> None:
        self._network = OnnxSession(path, "The detector 'onnx'", _SOURCE, _NEEDED)
        self.channels, self.size_px = self._network.channels, self._network.size_px
        if self.channels not in _CHANNELS or self._network.outputs != 4:
            raise self._network.other_tensors()
        shapes = [one.shape for one in self._network.try_out()]
        if any(shape != (1, 1, self.size_px, self.size_px) for shape in shapes):
            raise ConfigError(f"{path} gives maps of the shapes {shapes}.", _NEEDED)

    @property
    def needs_depth(self) -> bool:
        """Whether depth is among its input."""
        return self.channels != 3

    def detect(
        self,
        color: npt.NDArray[np.uint8],
        depth_m: npt.NDArray[np.float32] | None,
        on: npt.NDArray[np.bool_] | None = None,
    ) -> Rectangle:
        """Return the best grasp in an image (H, W, 3), with depth (H, W) [m] or None.

        Args:
            on: (H, W) the objects. The network sees a square around them at the image's own scale, as it was trained
                to - a larger one, made smaller, only where they do not fit -, and a grasp is looked for on them only.
                None = anywhere in the image's central square.

        Raises: ConfigError when the network needs depth and there is none.
        """
        if self.needs_depth and (depth_m is None or depth_m.shape != color.shape[:2]):
            raise ConfigError(f"This network needs {_CHANNELS[self.channels]}; the image has no depth of its own size.")
        square, scale = self._square(color.shape, on)
        planes = self._planes(color[square], None if depth_m is None else depth_m[square])
        quality, cos2, sin2, width = (one[0, 0] for one in self._network.run(planes))
        smooth = cv2.GaussianBlur(quality, (0, 0), _SMOOTHING_PX)
        if on is not None and on[square].any():
            size = (self.size_px, self.size_px)
            smooth = np.where(cv2.resize(on[square].astype(np.float32), size) > 0, smooth, -np.inf)
        row, column = np.unravel_index(int(smooth.argmax()), smooth.shape)
        angle = 0.5 * float(np.arctan2(sin2[row, column], cos2[row, column]))
        opening_px = max(float(width[row, column]), 0.02) * _WIDTH_PX * scale
        top, left = square[0].start, square[1].start
        return Rectangle(
            center_px=((float(column) + 0.5) * scale - 0.5 + left, (float(row) + 0.5) * scale - 0.5 + top),
            angle_rad=float(-angle % np.pi),
            width_px=opening_px,
            height_px=_HEIGHT_SHARE * opening_px,
        )

    def _square(self, shape: tuple[int, ...], on: npt.NDArray[np.bool_] | None) -> tuple[tuple[slice, slice], float]:
        """The square of the image that the network sees, and the image's pixels in one of the network's."""
        sides, least = shape[:2], min(shape[:2])
        if on is None or not on.any():
            lines, side = [np.arange(one) for one in sides], least
        else:
            lines = [np.flatnonzero(on.any(axis=1)), np.flatnonzero(on.any(axis=0))]
            extent = round(_ROOM * max(np.ptp(line) + 1 for line in lines))
            side = min(max(self.size_px, extent), least)
        top, left = (
            int(np.clip((line[0] + line[-1] + 1 - side) // 2, 0, most - side))
            for line, most in zip(lines, sides, strict=True)
        )
        return (slice(top, top + side), slice(left, left + side)), side / self.size_px

    def _planes(self, color: npt.NDArray[np.uint8], depth_m: npt.NDArray[np.float32] | None) -> Array:
        """The input planes (C, S, S), as the class describes."""
        planes: list[Array] = []
        if depth_m is not None and self.needs_depth:
            if not np.isfinite(depth_m).any():
                raise ConfigError(f"This network needs {_CHANNELS[self.channels]}; every depth is unknown.")
            small = self._resized(_filled(depth_m))
            planes.append(np.clip(small - small.mean(), -1, 1)[None])
        if self.channels != 1:
            rgb = self._resized(color) / 255
            planes.append((rgb - rgb.mean()).transpose(2, 0, 1))
        return np.ascontiguousarray(np.concatenate(planes), dtype=np.float32)

    def _resized(self, image: npt.NDArray[Any]) -> Array:
        size = (self.size_px, self.size_px)
        how = cv2.INTER_AREA if image.shape[0] >= self.size_px else cv2.INTER_LINEAR
        return np.asarray(cv2.resize(np.ascontiguousarray(image), size, interpolation=how), dtype=np.float32)


def _filled(depth_m: npt.NDArray[np.float32]) -> Array:
    """Depth (H, W) with every hole filled from the nearest pixel that has depth."""
    nearest = ndimage.distance_transform_edt(~np.isfinite(depth_m), return_distances=False, return_indices=True)
    return np.asarray(depth_m[tuple(nearest)], dtype=np.float32)
