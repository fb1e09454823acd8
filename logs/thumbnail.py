"""A small picture of a recorded cycle: what the camera saw, with the chosen object and the chosen grasp."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from google.protobuf.message import DecodeError

from bus import topics
from bus.errors import RecordingError
from logs.image_annotations import GREEN, ORANGE, color_message
from logs.mcap.finished_reader import Summary
from logs.mcap.names import reading, shown
from logs.mcap.records import Damage

_COLOR, _DRAWN = f"/{topics.VIEW_COLOR.key}", f"/{topics.VIEW_ANNOTATIONS.key}"
_SEEN, _FOUND = f"/{topics.CAMERA_COLOR.key}", f"/{topics.VIEW_GOAL.key}"
_QUALITY = 80


def thumbnail(path: Path, width_px: int = 320) -> bytes | None:
    """A JPEG of so many pixels across; None where the cycle has shown no picture. Raises: RecordingError."""
    try:
        with reading(path), path.open("rb") as file:
            last = dict(Summary(file).messages(frozenset({_COLOR, _DRAWN, _SEEN, _FOUND})))
        shown_on = _COLOR if _FOUND in last else _SEEN if _SEEN in last else _COLOR  # where nothing was found: on grey
        if shown_on not in last:
            return None
        image, scale = _scaled(CompressedImage.FromString(last[shown_on]).data, width_px)
        _draw(image, ImageAnnotations.FromString(last.get(_DRAWN, b"")), scale)
    except (Damage, DecodeError, ValueError, cv2.error) as error:
        raise RecordingError(f"{shown(path)} has no picture that can be read: {error}.", "See `cell show`.") from error
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes())


def _scaled(data: bytes, width_px: int) -> tuple[np.ndarray, float]:
    """The image (h, width_px, 3), BGR, and its scale. Raises: ValueError."""
    whole = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if whole is None:
        raise ValueError("it is no image")
    scale = width_px / whole.shape[1]
    size = (width_px, max(1, round(whole.shape[0] * scale)))
    return cv2.resize(whole, size, interpolation=cv2.INTER_AREA), scale


def _draw(image: np.ndarray, drawn: ImageAnnotations, scale: float) -> None:
    for color in (ORANGE, GREEN):
        message = color_message(color)
        loops = [
            np.array([[point.x * scale, point.y * scale] for point in line.points]).round().astype(np.int32)
            for line in drawn.points
            if line.outline_color == message and line.points
        ]
        bgr = tuple(round(255 * part) for part in reversed(color))
        cv2.polylines(image, loops, True, bgr, 2, cv2.LINE_AA)
