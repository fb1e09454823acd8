"""The last picture that the cell has shown, and what is drawn into it, for a page."""

from __future__ import annotations

import hashlib
import json
from typing import Any, NamedTuple

from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from google.protobuf.message import DecodeError

from bus import topics
from bus.sample import Sample
from logs.image_annotations import BLUE, GREEN, GREY, ORANGE, color_message

_TYPES = {"jpeg": "image/jpeg", "png": "image/png"}
_KINDS = {GREEN: "grasp", BLUE: "other_grasp", ORANGE: "object", GREY: "rod"}
"""What the colours mean; any other outlines a thing."""
_PLACES = 1
"""Decimals of a pixel's coordinates."""


class Picture(NamedTuple):
    """One picture file. ``stamp_ns``: of the frame, UTC. ``etag``: names its content."""

    data: bytes
    media_type: str
    stamp_ns: int
    etag: str


class Pictures:
    """The last colour image of the bus, and its annotations.

    Attributes:
        picture: None before the first one. ``scene``: the annotations as JSON, "" before the first.
    """

    # They travel apart, and the larger picture may come second: a page compares their stamps.

    def __init__(self) -> None:
        self.picture: Picture | None = None
        self.scene = ""

    def hear(self, sample: Sample) -> tuple[str, int] | None:
        """Take a sample of `topics.VIEW_COLOR` or `topics.VIEW_ANNOTATIONS`.

        Returns: ``picture`` or ``scene``, and its stamp [ns, UTC]; None when the sample cannot be read.
        """
        try:
            if sample.key == topics.VIEW_COLOR.key:
                self.picture = _picture(CompressedImage.FromString(sample.payload))
                return "picture", self.picture.stamp_ns
            scene = _scene(ImageAnnotations.FromString(sample.payload))
            self.scene = json.dumps(scene, allow_nan=False)
        except (DecodeError, ValueError):
            return None
        return "scene", scene["stamp_ns"]


def _picture(image: CompressedImage) -> Picture:
    """The file in a message. Raises: ValueError for a format that no page shows."""
    media_type = _TYPES.get(image.format)
    if media_type is None:
        raise ValueError(f"no page shows {image.format!r}")
    data, stamp_ns = bytes(image.data), image.timestamp.ToNanoseconds()
    return Picture(data, media_type, stamp_ns, f'"{stamp_ns}-{hashlib.sha256(data).hexdigest()[:8]}"')


def _scene(drawn: ImageAnnotations) -> dict[str, Any]:
    """Closed lines and numbers, in pixels of the picture."""
    stamps = [line.timestamp.ToNanoseconds() for line in drawn.points]
    return {
        "stamp_ns": max(stamps, default=0),
        "outlines": [
            {
                "kind": _KIND_OF.get(_css(line.outline_color), "thing"),
                "color": _css(line.outline_color),
                "points_px": [[round(point.x, _PLACES), round(point.y, _PLACES)] for point in line.points],
            }
            for line in drawn.points
        ],
        "numbers": [
            {"text": text.text, "at_px": [round(text.position.x, _PLACES), round(text.position.y, _PLACES)]}
            for text in drawn.texts
        ],
    }


def _css(color: Color) -> str:
    return "#" + "".join(f"{round(255 * min(1.0, max(0.0, part))):02x}" for part in (color.r, color.g, color.b))


_KIND_OF = {_css(color_message(color)): kind for color, kind in _KINDS.items()}
