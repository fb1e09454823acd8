"""The last picture that the cell has shown, and what is drawn into it, for a page."""

from __future__ import annotations

import hashlib
import json
from typing import Any, NamedTuple

import cv2
import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from google.protobuf.message import DecodeError

from bus import topics
from bus.messages import LivePicture
from bus.sample import Sample
from logs.image_annotations import BLUE, GREEN, GREY, ORANGE, UNSEEN, color_message
from logs.scene_picture import color_of

_TYPES = {"jpeg": "image/jpeg", "png": "image/png"}
_KINDS = {GREEN: "grasp", BLUE: "other_grasp", ORANGE: "object", GREY: "rod", UNSEEN: "unseen"}
"""The meaning of the colours; any other outlines a thing."""
_KEPT = 8
"""Pictures that can still be had by their stamp: a page that is told of one loads it a moment later."""
_UNSEEN_PX, _FEW = 0.7, 8
"""How far a line may be from the true one; lines of so few corners stay as they are."""
_PLACES = 1
"""Decimals of a pixel's coordinates."""


class Picture(NamedTuple):
    """One picture file. ``stamp_ns``: of the frame, UTC. ``etag``: names its content."""

    data: bytes
    media_type: str
    stamp_ns: int
    etag: str


class Pictures:
    """The last colour images, and the last annotations.

    Attributes:
        scene: the annotations as JSON, "" before the first.
    """

    # They travel apart, and the larger picture may come second: a page compares their stamps.

    def __init__(self) -> None:
        self._kept: dict[int, Picture] = {}
        self._seen: Picture | None = None
        self.scene = ""

    @property
    def picture(self) -> Picture | None:
        """The last one."""
        return next(reversed(self._kept.values()), None)

    def at(self, stamp_ns: int) -> Picture | None:
        """Return the picture of that stamp [ns, UTC]; None when it is not kept any more."""
        if self._seen is not None and self._seen.stamp_ns == stamp_ns:
            return self._seen
        return self._kept.get(stamp_ns)

    def take(self, live: LivePicture) -> None:
        """Take a picture of now."""
        self._keep(_named(bytes(live.data), live.media_type, live.stamp_ns))

    def _keep(self, picture: Picture) -> None:
        self._kept.pop(picture.stamp_ns, None)
        self._kept[picture.stamp_ns] = picture
        while len(self._kept) > _KEPT:
            del self._kept[next(iter(self._kept))]

    def hear(self, sample: Sample) -> tuple[str, int] | None:
        """Take a sample of `topics.VIEW_COLOR` or `topics.VIEW_ANNOTATIONS`.

        Returns: ``picture`` or ``scene``, and its stamp [ns, UTC]; None when the sample cannot be read.
        """
        try:
            if sample.key == topics.VIEW_COLOR.key:
                picture = _picture(CompressedImage.FromString(sample.payload))
                self._keep(picture)
                self._seen = picture
                return "picture", picture.stamp_ns
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
    return _named(bytes(image.data), media_type, image.timestamp.ToNanoseconds())


def _named(data: bytes, media_type: str, stamp_ns: int) -> Picture:
    return Picture(data, media_type, stamp_ns, f'"{stamp_ns}-{hashlib.sha256(data).hexdigest()[:8]}"')


def _scene(drawn: ImageAnnotations) -> dict[str, Any]:
    """Closed lines and numbers, in pixels of the picture."""
    stamps = [line.timestamp.ToNanoseconds() for line in drawn.points]
    number_of = {
        _css(color_message(_share(int(one.text)))): int(one.text) for one in drawn.texts if one.text.isdecimal()
    }
    return {
        "stamp_ns": max(stamps, default=0),
        "stamp": str(max(stamps, default=0)),
        "outlines": [
            {
                "kind": _KIND_OF.get(_css(line.outline_color), "thing"),
                "color": _css(line.outline_color),
                "number": number_of.get(_css(line.outline_color), 0),
                "points_px": _coarse(line),
            }
            for line in drawn.points
        ],
        "numbers": [
            {"text": text.text, "at_px": [round(text.position.x, _PLACES), round(text.position.y, _PLACES)]}
            for text in drawn.texts
        ],
    }


def _coarse(line: PointsAnnotation) -> list[list[float]]:
    """The corners of a closed line, without those that one would not see on a page."""
    corners = np.array([[point.x, point.y] for point in line.points], dtype=np.float32).reshape(-1, 1, 2)
    kept = cv2.approxPolyDP(corners, _UNSEEN_PX, True) if len(corners) > _FEW else corners
    return [[round(float(u), _PLACES), round(float(v), _PLACES)] for u, v in kept.reshape(-1, 2)]


def _share(number: int) -> tuple[float, float, float]:
    """The colour of a thing, each part from 0 to 1."""
    red, green, blue = color_of(number)
    return red / 255, green / 255, blue / 255


def _css(color: Color) -> str:
    return "#" + "".join(f"{round(255 * min(1.0, max(0.0, part))):02x}" for part in (color.r, color.g, color.b))


_KIND_OF = {_css(color_message(color)): kind for color, kind in _KINDS.items()}
