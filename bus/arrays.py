"""NumPy arrays as fields of messages: exact in JSON, read-only in memory.

An array of fewer than 64 finite numbers travels as lists, ``[0.1, -0.7]``, nested by its shape; any other as
``{"dtype": "<f8", "shape": [n, 7], "base64": "..."}``; both forms are accepted at any size. An image travels as
``{"png": "<base64>"}``. All come back bit for bit. Frames and units: docs/frames.md.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator, PlainSerializer, WithJsonSchema

from bus.lazy import LazyModule
from bus.packing import Shape, pack_array, pack_blob, pack_image, unpack_array, unpack_blob, unpack_image

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt
else:
    np = LazyModule("numpy")

ARM_JOINTS = (6, 7)
"""An arm has six joints, or as the FR3 seven."""

_BYTES_SCHEMA = {
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
    """Return a read-only, contiguous array that shares no memory with a writeable one."""
    if not array.flags.writeable and array.flags.c_contiguous:
        return array
    copy = np.array(array, order="C", copy=True)
    copy.setflags(write=False)
    return copy


def _measured(depth_m: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return depth [m] with NaN for what devices write where they measured nothing: 0, a negative number, infinity."""
    is_hole = (depth_m <= 0) | np.isinf(depth_m)
    return np.where(is_hole, np.float32(np.nan), depth_m) if is_hole.any() else depth_m


def _schema(shape: Shape) -> dict[str, Any]:
    """Return the JSON schema of both forms in which an array of ``shape`` travels."""
    lists: dict[str, Any] = {"type": "number"}
    for length in reversed(shape):
        lists = {"type": "array", "items": lists}
        if length is not None:
            least, most = length if isinstance(length, tuple) else (length, length)
            lists |= {"minItems": least, "maxItems": most}
    return {"anyOf": [lists, _BYTES_SCHEMA]}


def _field(parse: Callable[[Any], Any], pack: Callable[[Any], Any], schema: dict[str, Any]) -> Any:
    # typed as Any, because naming the array type would import NumPy; `parse` returns an array
    return Annotated[Any, BeforeValidator(parse), PlainSerializer(pack, when_used="json"), WithJsonSchema(schema)]


def array_of(dtype: str, *shape: int | None, made: Callable[[Any], Any] = lambda array: array) -> Any:
    """Return the pydantic field type of an array of ``dtype`` and ``shape``; ``None`` stands for any length.

    Args:
        made: what becomes of an array that fits.
    """
    return _field(lambda value: _frozen(made(unpack_array(value, dtype, shape))), pack_array, _schema(shape))


def _image(channels: int, dtype: str) -> Any:
    return _field(lambda value: _frozen(unpack_image(value, channels, dtype)), pack_image, _IMAGE_SCHEMA)


# mypy reads the first branch, pydantic the second.
if TYPE_CHECKING:
    Blob = bytes
    Joints = npt.NDArray[np.float64]
    JointSamples = npt.NDArray[np.float64]
    Samples = npt.NDArray[np.float64]
    Transform = npt.NDArray[np.float64]
    Vector3 = npt.NDArray[np.float64]
    Points = npt.NDArray[np.float32]
    PoseSamples = npt.NDArray[np.float32]
    Triangles = npt.NDArray[np.uint16]
    PointColors = npt.NDArray[np.uint16]
    ColorImage = npt.NDArray[np.uint8]
    DepthImage = npt.NDArray[np.float32]
    Mask = npt.NDArray[np.bool_]
    LabelImage = npt.NDArray[np.uint8]
else:
    Joints = array_of("float64", ARM_JOINTS)  # [rad] or [rad/s] or [Nm], base to wrist
    JointSamples = array_of("float64", None, ARM_JOINTS)  # (n, joints), one row per sample
    Samples = array_of("float64", None)
    Transform = array_of("float64", 4, 4)  # homogeneous; a_from_b maps b-coordinates to a
    Vector3 = array_of("float64", 3)
    Points = array_of("float32", None, 3)  # [m]
    PoseSamples = array_of("float32", None, None, 3, 4)  # upper rows of homogeneous poses, one row of them per sample
    Triangles = array_of("uint16", None, 3)  # indices of points
    PointColors = array_of("uint16", None, 3)  # RGB, 0 to 255
    DepthImage = array_of("float32", None, None, made=_measured)  # [m], NaN = invalid
    ColorImage = _image(3, "uint8")  # RGB
    Mask = _image(1, "bool")
    LabelImage = _image(1, "uint8")  # numbers, 0 = none
    Blob = Annotated[
        bytes,
        BeforeValidator(unpack_blob),
        PlainSerializer(pack_blob, when_used="json"),
        WithJsonSchema({"type": "string", "contentEncoding": "base64"}),
    ]  # a file's bytes, unchanged
