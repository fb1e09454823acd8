"""Grasp networks of the GG-CNN family (GG-CNN, GR-ConvNet and similar) through ONNX: an image in, four maps out."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from bus.errors import ConfigError
from bus.messages import Rectangle

_WIDTH_PX = 150.0
"""Width in network pixels of a width map's value 1 (Morrison et al. 2018, Kumra et al. 2020)."""
_HEIGHT_SHARE = 0.5
_SMOOTHING_PX = 2.0
_NEEDED = "Needed: (1, 1|3|4, S, S) float32 -> four maps (1, 1, S, S)."
_REFUSALS = ("Fail", "InvalidArgument", "InvalidGraph", "NoSuchFile", "NotImplemented", "RuntimeException")
_CHANNELS = {1: "depth", 3: "colour", 4: "depth and colour"}

Array = npt.NDArray[np.float32]


class GraspNetwork:
    """A grasp network, defined by its tensors and independent of its training framework.

    Input: (1, C, S, S) float32. C = 1: depth; 3: RGB; 4: depth, then RGB. Depth is in metres less its mean, clipped to
    +-1; RGB is in 0..1 less its mean. Outputs: four maps (1, 1, S, S), in this order: quality, cos 2a, sin 2a, width.
    a is the closing axis' angle counter-clockwise (image v points down, so it is negated here); width is in units of
    150
    px. The rectangle is half as high as wide, the family's convention.

    Args:
        path: the ``.onnx`` file.

    Raises: ConfigError for a missing package, a file that is not such a network, or other tensors.
    """

    def __init__(self, path: Path) -> None:
        if find_spec("onnxruntime") is None:
            raise ConfigError("The detector 'onnx' needs onnxruntime.", "Install it: uv pip install 'vlad-cell[onnx]'.")
        runtime: Any = import_module("onnxruntime")
        if not path.is_file():
            raise ConfigError(f"There is no network {path}.", "Name an .onnx file.")
        states = runtime.capi.onnxruntime_pybind11_state
        refusals = tuple(getattr(states, name) for name in _REFUSALS)
        options = runtime.SessionOptions()
        options.intra_op_num_threads = 1
        try:
            self._session = runtime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
            self._input, self.channels, self.size_px = self._tensors(path)
            self._try_out(path)
        except states.InvalidProtobuf as error:
            raise ConfigError(f"{path} is no ONNX file.") from error
        except refusals as error:
            raise ConfigError(f"{path} is no network that onnxruntime can run ({error}).") from error

    def _tensors(self, path: Path) -> tuple[str, int, int]:
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        shape = inputs[0].shape if len(inputs) == 1 else []
        fits = len(outputs) == 4 and len(shape) == 4 and shape[1] in _CHANNELS and inputs[0].type == "tensor(float)"
        if not fits or shape[2] != shape[3] or not isinstance(shape[2], int):
            found = f"{[(one.shape, one.type) for one in inputs]} -> {[one.shape for one in outputs]}"
            raise ConfigError(f"{path} has the tensors {found}.", _NEEDED)
        return inputs[0].name, shape[1], shape[2]

    def _try_out(self, path: Path) -> None:
        """Run once on zeros: the declared shapes of the maps may differ from the actual ones. Raises: ConfigError."""
        nothing = np.zeros((1, self.channels, self.size_px, self.size_px), dtype=np.float32)
        shapes = [np.shape(one) for one in self._session.run(None, {self._input: nothing})]
        if any(shape != (1, 1, self.size_px, self.size_px) for shape in shapes):
            raise ConfigError(f"{path} gives maps of the shapes {shapes} for {nothing.shape}.", _NEEDED)

    def detect(self, color: npt.NDArray[np.uint8], depth_m: npt.NDArray[np.float32] | None) -> Rectangle:
        """The best grasp in the central square of an image (H, W, 3), with depth (H, W) [m] or None.

        Raises: ConfigError when the network needs depth and there is none.
        """
        if self.channels != 3 and (depth_m is None or depth_m.shape != color.shape[:2]):
            raise ConfigError(f"This network needs {_CHANNELS[self.channels]}; the image has no depth of its own size.")
        side = min(color.shape[:2])
        top, left = (color.shape[0] - side) // 2, (color.shape[1] - side) // 2
        square = np.s_[top : top + side, left : left + side]
        planes = self._planes(color[square], None if depth_m is None else depth_m[square])
        maps = self._session.run(None, {self._input: planes[None]})
        quality, cos2, sin2, width = (np.asarray(one, dtype=np.float32).reshape(self.size_px, -1) for one in maps)
        smooth = cv2.GaussianBlur(quality, (0, 0), _SMOOTHING_PX)
        row, column = np.unravel_index(int(smooth.argmax()), smooth.shape)
        angle = 0.5 * float(np.arctan2(sin2[row, column], cos2[row, column]))
        scale = side / self.size_px
        opening_px = max(float(width[row, column]), 0.02) * _WIDTH_PX * scale
        return Rectangle(
            center_px=((float(column) + 0.5) * scale - 0.5 + left, (float(row) + 0.5) * scale - 0.5 + top),
            angle_rad=float(-angle % np.pi),
            width_px=opening_px,
            height_px=_HEIGHT_SHARE * opening_px,
        )

    def _planes(self, color: npt.NDArray[np.uint8], depth_m: npt.NDArray[np.float32] | None) -> Array:
        """The input planes (C, S, S), as the class describes."""
        size = (self.size_px, self.size_px)
        planes: list[Array] = []
        if depth_m is not None and self.channels != 3:
            if not np.isfinite(depth_m).any():
                raise ConfigError(f"This network needs {_CHANNELS[self.channels]}; every depth is unknown.")
            known = np.where(np.isfinite(depth_m), depth_m, np.nanmedian(depth_m)).astype(np.float32)
            small = np.asarray(cv2.resize(known, size, interpolation=cv2.INTER_AREA))
            planes.append(np.clip(small - small.mean(), -1, 1)[None])
        if self.channels != 1:
            rgb = np.asarray(cv2.resize(color, size, interpolation=cv2.INTER_AREA), dtype=np.float32) / 255
            planes.append((rgb - rgb.mean()).transpose(2, 0, 1))
        return np.ascontiguousarray(np.concatenate(planes), dtype=np.float32)
