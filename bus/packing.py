"""Packs arrays, images and file bytes for JSON, and unpacks them; a value of another kind is a ValueError.

Input is foreign: no type, size or shape that it names is trusted.
"""

from __future__ import annotations

import base64
import math
import struct
from typing import TYPE_CHECKING, Any

from bus.lazy import LazyModule

if TYPE_CHECKING:
    import cv2
    import numpy as np
    import numpy.typing as npt
else:
    cv2, np = LazyModule("cv2"), LazyModule("numpy")

MAX_LISTED = 64
"""Arrays of fewer numbers travel as plain lists."""
MAX_PIXELS = 64_000_000
"""An image whose header names more is not decoded, because a file of a few kB can name any size."""
_DTYPES = frozenset(f"{order}{kind}" for order in "<>" for kind in ("f4", "f8", "i4", "i8", "u2", "u4", "u8"))
_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_SIZE = struct.Struct(">4sII")
"""The start of a PNG's first chunk, after its length: chunk name, width, height."""

Shape = tuple[int | tuple[int, int] | None, ...]
"""Shape of a field; None stands for any length, a pair for the least and the largest."""


# --- arrays -----------------------------------------------------------------------------------------------------------


def pack_array(array: npt.NDArray[Any]) -> Any:
    """Return a short array of finite numbers as lists, nested by its shape; any other with its bytes in base64."""
    if 0 < array.size < MAX_LISTED and np.isfinite(array).all():
        return array.tolist()
    little = array.astype(array.dtype.newbyteorder("<"), copy=False)
    return {
        "dtype": little.dtype.str,
        "shape": list(array.shape),
        "base64": base64.b64encode(little.tobytes()).decode("ascii"),
    }


def unpack_array(value: Any, dtype: str, shape: Shape) -> npt.NDArray[Any]:
    """Return the array behind either packed form; an array or a sequence of a caller in this process is accepted too.

    Args:
        dtype: NumPy type of the result, e.g. ``float64``.
        shape: required shape; None = any length.

    Raises:
        ValueError: the value is no array of real numbers, has another shape, or overflows ``dtype``.
    """
    array = _from_bytes(value) if isinstance(value, dict) else np.asarray(value)
    if array.size == 0 and array.ndim == 1:
        array = array.reshape([0 if wanted is None else _between(wanted)[1] for wanted in shape])
    fits = array.ndim == len(shape) and all(map(_fits, shape, array.shape))
    if not fits:
        raise ValueError(f"expected shape {shape} (None = any), got {array.shape}")
    if array.dtype.kind not in "fiu":
        raise ValueError("expected numbers only")
    return _as_type(array, dtype)


def _between(wanted: int | tuple[int, int]) -> tuple[int, int]:
    return wanted if isinstance(wanted, tuple) else (wanted, wanted)


def _fits(wanted: int | tuple[int, int] | None, length: int) -> bool:
    return wanted is None or _between(wanted)[0] <= length <= _between(wanted)[1]


def _as_type(array: npt.NDArray[Any], dtype: str) -> npt.NDArray[Any]:
    with np.errstate(over="ignore"):
        converted = array.astype(dtype, copy=False)
    if converted.dtype.itemsize < array.dtype.itemsize and (np.isinf(converted) & np.isfinite(array)).any():
        raise ValueError(f"a number is too large for {dtype}")
    return converted


def _from_bytes(packed: dict[Any, Any]) -> npt.NDArray[Any]:
    if packed.keys() != {"dtype", "shape", "base64"}:
        raise ValueError("expected lists of numbers, or dtype, shape and base64")
    dtype, shape = packed["dtype"], packed["shape"]
    if not isinstance(dtype, str) or dtype not in _DTYPES:
        raise ValueError(f"dtype must be one of {', '.join(sorted(_DTYPES))}")
    if not isinstance(shape, list | tuple) or not all(type(n) is int and 0 <= n <= 2**31 for n in shape):
        raise ValueError("shape must be a list of lengths")
    data = from_base64(packed["base64"])
    item = np.dtype(dtype)
    if math.prod(shape) * item.itemsize != len(data):
        raise ValueError(f"{len(data)} bytes are no array of shape {list(shape)} and type {dtype}")
    return np.frombuffer(data, item).reshape(shape)


def from_base64(text: Any) -> bytes:
    """Decode base64. Raises: ValueError."""
    if not isinstance(text, str):
        raise ValueError("expected base64")
    return base64.b64decode(text, validate=True)


# --- images -----------------------------------------------------------------------------------------------------------


def pack_image(image: npt.NDArray[Any]) -> dict[str, str]:
    """Return an RGB image (H, W, 3) or a mask (H, W) as a PNG in base64. Raises: ValueError if it cannot be encoded."""
    pixels = image.astype(np.uint8) * 255 if image.dtype == np.bool_ else image
    ok, png = cv2.imencode(".png", pixels[..., ::-1] if pixels.ndim == 3 else pixels)
    if not ok:
        raise ValueError(f"cannot encode an image of shape {image.shape} as PNG")
    return {"png": base64.b64encode(png.tobytes()).decode("ascii")}


def unpack_image(value: Any, channels: int, dtype: str) -> npt.NDArray[Any]:
    """Return the image behind a packed one; an array of a caller in this process is accepted too.

    Args:
        channels: 3 for RGB (H, W, 3), 1 for a mask (H, W).
        dtype: ``uint8``, or ``bool``: pixels above 0 are set.

    Raises:
        ValueError: the value is no PNG, is too large, or has other channels.
    """
    array = _from_png(value, channels) if isinstance(value, dict) else value
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "biuf":
        raise ValueError("expected an image as png")
    wanted = 3 if channels == 3 else 2
    if array.ndim != wanted or (wanted == 3 and array.shape[2] != 3):
        raise ValueError(f"expected an image with {channels} channel(s), got shape {array.shape}")
    return array > 0 if dtype == "bool" else array.astype(dtype, copy=False)


def _from_png(packed: dict[Any, Any], channels: int) -> npt.NDArray[Any]:
    if packed.keys() != {"png"}:
        raise ValueError("expected an image as png")
    png = from_base64(packed["png"])
    _require_size(png)
    pixels: npt.NDArray[Any] | None = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None or pixels.dtype != np.uint8:
        raise ValueError("not a PNG image of 8 bits")
    return pixels[..., ::-1] if channels == 3 and pixels.ndim == 3 else pixels


def _require_size(png: bytes) -> None:
    """Check the size in the PNG's header before its pixels are unpacked. Raises: ValueError."""
    start = len(_PNG) + 4
    if not png.startswith(_PNG) or len(png) < start + _PNG_SIZE.size:
        raise ValueError("not a PNG image")
    name, width, height = _PNG_SIZE.unpack_from(png, start)
    if name != b"IHDR" or not 0 < width * height <= MAX_PIXELS:
        raise ValueError(f"an image has 1 to {MAX_PIXELS} pixels")


# --- bytes ------------------------------------------------------------------------------------------------------------


def unpack_blob(value: Any) -> bytes:
    """Return a file's bytes, from base64 or from bytes. Raises: ValueError."""
    return bytes(value) if isinstance(value, bytes | bytearray | memoryview) else from_base64(value)


def pack_blob(value: bytes) -> str:
    """Return a file's bytes as base64."""
    return base64.b64encode(value).decode("ascii")
