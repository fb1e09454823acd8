"""The square window around the object that a hosted model is shown and edits; it enlarges the object for the model.

Pixels are (u, v) of the undistorted colour image; see docs/frames.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from bus.codes import Code
from bus.errors import CycleFailure
from bus.picture_header import is_whole, size_of
from perception.geometry.crop import Crop

_ROOM = 1.9
"""Side of the window over the object's larger extent: room for a rod that protrudes."""
_MIN_SIDE_PX = 128
_ASPECT_TOLERANCE = 0.03
_MIN_PICTURE_PX = 128
_MAX_PICTURE_PX = 8192
"""Largest side of a picture, twice what any provider draws: a header may announce a size that exhausts the memory."""

Image = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Window:
    """A square of the colour image; it may extend beyond the image.

    Attributes:
        left, top: the first column and row [px]; may be negative. ``side_px``: its side.
    """

    left: int
    top: int
    side_px: int

    @staticmethod
    def around(object_mask: Mask) -> Window:
        """Return the square around the bounding box of ``object_mask`` (H, W), at least 128 px wide."""
        box = Crop.around(object_mask, 0)
        side = max(round(_ROOM * max(box.bottom - box.top, box.right - box.left)), _MIN_SIDE_PX)
        return Window((box.left + box.right - side) // 2, (box.top + box.bottom - side) // 2, side)

    def cut(self, image: npt.NDArray[np.uint8], beyond: int | tuple[int, int, int]) -> npt.NDArray[np.uint8]:
        """Return the window's part of ``image`` (H, W) or (H, W, 3), with ``beyond`` for pixels outside the image."""
        part = np.empty((self.side_px, self.side_px, *image.shape[2:]), dtype=np.uint8)
        part[:] = beyond
        inside, here = self._overlap(image.shape)
        part[inside] = image[here]
        return part

    def paste(self, part: Image, onto: Image) -> Image:
        """A copy of ``onto`` (H, W, 3) with the window replaced by ``part`` (side, side, 3)."""
        pasted = onto.copy()
        inside, here = self._overlap(onto.shape)
        pasted[here] = part[inside]
        return pasted

    def _overlap(self, shape: tuple[int, ...]) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
        top, left = max(0, self.top), max(0, self.left)
        bottom, right = min(shape[0], self.top + self.side_px), min(shape[1], self.left + self.side_px)
        inside = slice(top - self.top, bottom - self.top), slice(left - self.left, right - self.left)
        return inside, (slice(top, bottom), slice(left, right))


def encode_png(image: npt.NDArray[np.uint8], size_px: int) -> bytes:
    """A square image (RGB, RGBA or grey) as PNG of ``size_px``. Raises: ValueError when it cannot be encoded."""
    big = cv2.resize(np.ascontiguousarray(image), (size_px, size_px), interpolation=cv2.INTER_CUBIC)
    order = {3: cv2.COLOR_RGB2BGR, 4: cv2.COLOR_RGBA2BGRA}
    pixels = cv2.cvtColor(big, order[big.shape[2]]) if big.ndim == 3 else big
    ok, png = cv2.imencode(".png", pixels)
    if not ok:
        raise ValueError(f"cannot encode an image of shape {image.shape}")
    return bytes(png)


def decode_picture(data: bytes, window: Window, background: tuple[int, int, int] = (0, 0, 0)) -> Image:
    """Decode a model's picture to the window's pixels (side, side, 3); transparent pixels become ``background``.

    Raises: CycleFailure(MODEL_BAD_IMAGE) for a torn file, a format other than PNG, JPEG or WebP, a picture that is not
        square, or one larger than models draw.
    """
    size = size_of(data) if is_whole(data) else None
    if size is None:
        raise _bad(f"The goal image ({len(data)} bytes) is torn, or no PNG, JPEG or WebP picture.")
    if max(size) > _MAX_PICTURE_PX:
        raise _bad(f"The goal image has {size.width} x {size.height} pixels; it is not unpacked.")
    pixels = _decoded(data, background)
    height, width = pixels.shape[:2]
    if abs(width / height - 1) > _ASPECT_TOLERANCE:
        raise _bad(f"The goal image has {width} x {height} pixels; a square was asked for.")
    if height < _MIN_PICTURE_PX:
        raise _bad(f"The goal image has {width} x {height} pixels; it has at least {_MIN_PICTURE_PX} a side.")
    shrunk = cv2.resize(pixels, (window.side_px, window.side_px), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.cvtColor(shrunk, cv2.COLOR_BGR2RGB))


def _decoded(data: bytes, background: tuple[int, int, int]) -> Image:
    """(H, W, 3) BGR, with transparent pixels replaced by ``background`` (RGB)."""
    color, whole = _pixels(data, cv2.IMREAD_COLOR), _pixels(data, cv2.IMREAD_UNCHANGED)
    if whole.ndim < 3 or whole.shape[2] < 4 or whole.shape[:2] != color.shape[:2]:
        return color
    opaque = whole[..., 3:] / np.float32(np.iinfo(whole.dtype).max)
    return np.asarray(opaque * color + (1 - opaque) * np.array(background[::-1]), dtype=np.uint8)


def _pixels(data: bytes, how: int) -> npt.NDArray[Any]:
    try:
        pixels = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), how)
    except cv2.error:
        pixels = None
    if pixels is None:
        raise _bad(f"The goal image ({len(data)} bytes) cannot be decoded.")
    return np.asarray(pixels)


def _bad(text: str) -> CycleFailure:
    return CycleFailure(Code.MODEL_BAD_IMAGE, text)
