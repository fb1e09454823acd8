"""Requests to a stand-in of a hosted model and its answers, independent of the API."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]
Kind = Literal["text", "image"]


class Fault(StrEnum):
    """The ways in which an answer goes wrong."""

    RATE_LIMIT = "rate_limit"
    SERVER_ERROR = "server_error"
    HANG = "hang"
    TRUNCATED_PNG = "truncated_png"
    WRONG_SIZE = "wrong_size"
    REFUSAL = "refusal"
    TEXT_ONLY = "text_only"
    UNAUTHORIZED = "unauthorized"
    NO_CONTENT = "no_content"


OF_PICTURES = frozenset({Fault.TRUNCATED_PNG, Fault.WRONG_SIZE, Fault.TEXT_ONLY})
"""Faults that only an answer with a picture can have."""


class Picture(NamedTuple):
    """The picture that a painter is given.

    Attributes:
        image: (H, W, 3) RGB.
        mask: (H, W) where editing is allowed; None = the request says nothing of it.
    """

    image: Image
    mask: Mask | None
    prompt: str


@dataclass(frozen=True, eq=False)
class Request:
    """One request as it was understood.

    Attributes:
        image: (H, W, 3) RGB, the first one. ``others``: the further ones.
        mask: (H, W) where editing is allowed.
        size: (width, height) asked for.
    """

    path: str
    kind: Kind
    model: str
    prompt: str
    image: Image | None = None
    others: tuple[Image, ...] = ()
    mask: Mask | None = None
    size: tuple[int, int] | None = None


@dataclass(frozen=True)
class Reply:
    """One HTTP answer."""

    status: int
    body: Mapping[str, Any]
    headers: Mapping[str, str] = field(default_factory=dict)


class BadRequest(Exception):
    """The request is not one the API takes."""


def decode(data: bytes) -> Image:
    """RGB of a picture file. Raises: BadRequest."""
    return np.asarray(cv2.cvtColor(_pixels(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB))


def decode_mask(data: bytes) -> Mask:
    """Return where the picture file is fully transparent. Raises: BadRequest."""
    pixels = _pixels(data, cv2.IMREAD_UNCHANGED)
    if pixels.ndim != 3 or pixels.shape[2] != 4:
        raise BadRequest("Invalid mask image format - mask image must have an alpha channel.")
    return np.asarray(pixels[..., 3] == 0)


def encode(image: Image) -> bytes:
    """PNG of an RGB image."""
    ok, png = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    if not ok:
        raise ValueError(f"cannot encode an image of shape {image.shape}")
    return bytes(png)


def from_base64(text: str) -> bytes:
    """Bytes of either alphabet of base64. Raises: BadRequest."""
    try:
        return base64.b64decode(text.replace("-", "+").replace("_", "/"), validate=True)
    except binascii.Error as error:
        raise BadRequest(f"Invalid base64 data ({error}).") from error


def to_base64(data: bytes) -> str:
    """Base64 as text."""
    return base64.b64encode(data).decode("ascii")


def text_tokens(text: str) -> int:
    """Roughly what a tokenizer counts."""
    return -(-len(text) // 4)


def image_tokens(request: Request) -> int:
    """A flat price for each picture shown."""
    return 258 * (len(request.others) + (request.image is not None))


def _pixels(data: bytes, flags: int) -> Image:
    pixels = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags) if data else None
    if pixels is None:
        raise BadRequest("Invalid image file or mode, please check your image file.")
    return np.asarray(pixels)
