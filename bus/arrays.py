"""NumPy arrays as fields of messages: exact in JSON, read-only in memory.

An array travels as ``{"dtype": "<f8", "shape": [n, 7], "base64": "..."}``, an image as ``{"png": "<base64>"}``;
both come back bit for bit.
"""

from __future__ import annotations

import base64
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any

import cv2
import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, PlainSerializer, WithJsonSchema

_ARRAY_SCHEMA = {
    "type": "object",
    "properties": {
        "dtype": {"type": "string"},
        "shape": {"type": "array", "items": {"type": "integer"}},
        "base64": {"type": "string", "contentEncoding": "base64"},
    },
    "required": ["dtype", "shape", "base64"],
}
_IMAGE_SCHEMA = {
    "type": "object",
    "properties": {"png": {"type": "string", "contentEncoding": "base64"}},
    "required": ["png"],
}


def _frozen(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """A read-only, contiguous array that shares no memory with a writeable one."""
    if not array.flags.writeable and array.flags.c_contiguous:
        return array
    copy = np.array(array, order="C", copy=True)
    copy.setflags(write=False)
    return copy


def _parse(dtype: str, shape: tuple[int | None, ...]) -> Callable[[Any], npt.NDArray[Any]]:
    def parse(value: Any) -> npt.NDArray[Any]:
        if isinstance(value, dict):
            flat = np.frombuffer(base64.b64decode(value["base64"], validate=True), dtype=np.dtype(value["dtype"]))
            value = flat.reshape(value["shape"])
        array = np.asarray(value, dtype=dtype)
        fits = array.ndim == len(shape) and all(w is None or w == n for w, n in zip(shape, array.shape, strict=True))
        if not fits:
            raise ValueError(f"expected shape {shape} (None = any), got {array.shape}")
        return _frozen(array)

    return parse


def _pack(array: npt.NDArray[Any]) -> dict[str, Any]:
    little = array.astype(array.dtype.newbyteorder("<"), copy=False)
    return {
        "dtype": little.dtype.str,
        "shape": list(array.shape),
        "base64": base64.b64encode(little.tobytes()).decode("ascii"),
    }


def array_of(dtype: str, *shape: int | None) -> Any:
    """The field type of an array of ``dtype`` and ``shape``; ``None`` stands for any length."""
    return Annotated[
        npt.NDArray[Any],
        BeforeValidator(_parse(dtype, shape)),
        PlainSerializer(_pack, when_used="json"),
        WithJsonSchema(_ARRAY_SCHEMA),
    ]


def _parse_image(channels: int, dtype: str) -> Callable[[Any], npt.NDArray[Any]]:
    def parse(value: Any) -> npt.NDArray[Any]:
        if isinstance(value, dict):
            png = np.frombuffer(base64.b64decode(value["png"], validate=True), dtype=np.uint8)
            value = cv2.imdecode(png, cv2.IMREAD_UNCHANGED)
            if value is None:
                raise ValueError("not a PNG image")
            value = value[..., ::-1] if channels == 3 else value
        array = np.asarray(value)
        image = array > 0 if dtype == "bool" else array.astype(dtype, copy=False)
        if image.ndim != (3 if channels == 3 else 2):
            raise ValueError(f"expected an image with {channels} channel(s), got shape {image.shape}")
        return _frozen(image)

    return parse


def _pack_image(image: npt.NDArray[Any]) -> dict[str, str]:
    pixels = image.astype(np.uint8) * 255 if image.dtype == np.bool_ else image
    ok, png = cv2.imencode(".png", pixels[..., ::-1] if pixels.ndim == 3 else pixels)
    if not ok:
        raise ValueError(f"cannot encode an image of shape {image.shape} as PNG")
    return {"png": base64.b64encode(png.tobytes()).decode("ascii")}


def _image(channels: int, dtype: str) -> Any:
    return Annotated[
        npt.NDArray[Any],
        BeforeValidator(_parse_image(channels, dtype)),
        PlainSerializer(_pack_image, when_used="json"),
        WithJsonSchema(_IMAGE_SCHEMA),
    ]


def _parse_blob(value: Any) -> bytes:
    return base64.b64decode(value, validate=True) if isinstance(value, str) else bytes(value)


def _pack_blob(value: bytes) -> str:
    return base64.b64encode(value).decode("ascii")


# mypy reads the first branch, pydantic the second.
if TYPE_CHECKING:
    Blob = bytes
    Joints = npt.NDArray[np.float64]
    JointSamples = npt.NDArray[np.float64]
    Samples = npt.NDArray[np.float64]
    Transform = npt.NDArray[np.float64]
    Vector3 = npt.NDArray[np.float64]
    Points = npt.NDArray[np.float32]
    ColorImage = npt.NDArray[np.uint8]
    DepthImage = npt.NDArray[np.float32]
    Mask = npt.NDArray[np.bool_]
else:
    Joints = array_of("float64", 7)  # [rad] or [rad/s] or [Nm], base to wrist
    JointSamples = array_of("float64", None, 7)  # one row a sample
    Samples = array_of("float64", None)
    Transform = array_of("float64", 4, 4)  # homogeneous; a_from_b maps b-coordinates to a
    Vector3 = array_of("float64", 3)
    Points = array_of("float32", None, 3)  # [m]
    DepthImage = array_of("float32", None, None)  # [m], NaN = invalid
    ColorImage = _image(3, "uint8")  # RGB
    Mask = _image(1, "bool")
    Blob = Annotated[
        bytes,
        BeforeValidator(_parse_blob),
        PlainSerializer(_pack_blob, when_used="json"),
        WithJsonSchema({"type": "string", "contentEncoding": "base64"}),
    ]  # a file's bytes, as they came
