"""A network in an ``.onnx`` file through onnxruntime, an optional package that is imported only when one is opened."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from bus.errors import ConfigError

_REFUSALS = ("Fail", "InvalidArgument", "InvalidGraph", "NoSuchFile", "NotImplemented", "RuntimeException")

Array = npt.NDArray[np.float32]


class OnnxSession:
    """A network with one image as input, (1, C, S, S) float32, on one thread of the CPU.

    Args:
        path: the ``.onnx`` file.
        role: what needs it. ``source``: where one comes from. ``needed``: the tensors it must have. All for the errors.

    Attributes:
        channels, size_px: C and S. ``outputs``: number of its outputs.

    Raises: ConfigError for a missing package, a file that is no such network, or other inputs.
    """

    def __init__(self, path: Path, role: str, source: str, needed: str) -> None:
        if find_spec("onnxruntime") is None:
            raise ConfigError(f"{role} needs onnxruntime.", "Install it: uv pip install 'vlad-cell[onnx]'.")
        runtime: Any = import_module("onnxruntime")
        if not path.is_file():
            raise ConfigError(f"{role} needs a network; there is no file {path}.", source)
        self._path, self._needed, self._states = path, needed, runtime.capi.onnxruntime_pybind11_state
        options = runtime.SessionOptions()
        options.intra_op_num_threads = 1
        try:
            self._session = runtime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        except self._states.InvalidProtobuf as error:
            raise ConfigError(f"{path} is no ONNX file.", source) from error
        except self._refusals as error:
            raise ConfigError(f"{path} is no network that onnxruntime can run ({error}).") from error
        self._input, self.channels, self.size_px = self._read_input()
        self.outputs = len(self._session.get_outputs())

    @property
    def _refusals(self) -> tuple[type[Exception], ...]:
        return tuple(getattr(self._states, name) for name in _REFUSALS)

    def _read_input(self) -> tuple[str, int, int]:
        inputs = self._session.get_inputs()
        shape = inputs[0].shape if len(inputs) == 1 else []
        fits = len(shape) == 4 and all(isinstance(side, int) for side in shape[1:]) and shape[2] == shape[3]
        if not fits or inputs[0].type != "tensor(float)":
            raise self.other_tensors()
        return inputs[0].name, shape[1], shape[2]

    def other_tensors(self) -> ConfigError:
        """Return the error of a network with other tensors than needed."""
        inputs = [(one.shape, one.type) for one in self._session.get_inputs()]
        outputs = [one.shape for one in self._session.get_outputs()]
        return ConfigError(f"{self._path} has the tensors {inputs} -> {outputs}.", self._needed)

    def try_out(self) -> list[Array]:
        """Return the outputs for a ramp of values: declared shapes may differ from actual ones. Raises: ConfigError."""
        side = self.size_px
        ramp = np.linspace(-2, 2, side * side, dtype=np.float32).reshape(1, side, side)
        return self.run(np.repeat(ramp, self.channels, axis=0))

    def run(self, planes: Array) -> list[Array]:
        """All outputs for one image (C, S, S). Raises: ConfigError when onnxruntime cannot run the network."""
        try:
            outputs = self._session.run(None, {self._input: np.ascontiguousarray(planes[None], dtype=np.float32)})
        except self._refusals as error:
            raise ConfigError(f"{self._path} is no network that onnxruntime can run ({error}).") from error
        return [np.asarray(one, dtype=np.float32) for one in outputs]
