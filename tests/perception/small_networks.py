"""Small grasp networks without training, made with ``onnx`` for the tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

onnx = pytest.importorskip("onnx", reason="needs onnx: uv pip install 'vlad-cell[dev]'")
pytest.importorskip("onnxruntime", reason="needs onnxruntime: uv pip install 'vlad-cell[onnx]'")

SIZE = 64
SOBEL = np.array([[-1, 0, 1], [-2, 0, 2], [-1, 0, 1]], np.float32)
FLOAT = onnx.TensorProto.FLOAT
MAPS = ("quality", "cos2", "sin2", "wide")

Node = Any


def node(kind: str, inputs: str, output: str, **attributes: Any) -> Node:
    return onnx.helper.make_node(kind, inputs.split(), [output], **attributes)


def save(path: Path, channels: int, nodes: list[Node], constants: dict[str, np.ndarray]) -> Path:
    """A network of these nodes, from ``image`` to `MAPS`."""
    graph = onnx.helper.make_graph(
        nodes,
        "grasp",
        [onnx.helper.make_tensor_value_info("image", FLOAT, [1, channels, SIZE, SIZE])],
        [onnx.helper.make_tensor_value_info(name, FLOAT, [1, 1, SIZE, SIZE]) for name in MAPS],
        [onnx.numpy_helper.from_array(value, name) for name, value in constants.items()],
    )
    onnx.save(onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 13)], ir_version=9), str(path))
    return path


def gradients(path: Path) -> Path:
    """A grasp network without training: near is good, the jaw closes along the depth's gradient."""
    mean = {"kernel_shape": [15, 15], "pads": [7, 7, 7, 7]}
    edge = {"kernel_shape": [3, 3], "pads": [1, 1, 1, 1]}
    nodes = [
        node("Neg", "image", "near"),
        node("AveragePool", "near", "quality", **mean),
        node("Conv", "image sobel_u", "along_u", **edge),
        node("Conv", "image sobel_v", "along_v", **edge),
        node("Mul", "along_u along_u", "uu"),
        node("Mul", "along_v along_v", "vv"),
        node("Sub", "uu vv", "twice_cos"),
        node("AveragePool", "twice_cos", "cos2", **mean),
        node("Mul", "along_u along_v", "uv"),
        node("Mul", "uv minus_two", "twice_sin"),
        node("AveragePool", "twice_sin", "sin2", **mean),
        node("Mul", "near zero", "nothing"),
        node("Add", "nothing width", "wide"),
    ]
    scalars = {"minus_two": -2.0, "zero": 0.0, "width": 18 / 150}
    constants = {name: np.array(value, np.float32) for name, value in scalars.items()}
    constants |= {"sobel_u": SOBEL[None, None], "sobel_v": np.ascontiguousarray(SOBEL.T)[None, None]}
    return save(path, 1, nodes, constants)
