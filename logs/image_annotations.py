"""Outlines, rectangles and numbers in the undistorted colour image, as Foxglove's image annotations."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation

from bus.arrays import Mask
from bus.messages import Detections, ObservedScene
from bus.sensor_codec import stamp
from logs.scene_picture import color_of, outlines_px, places_px, unseen_px

Rgb = tuple[float, float, float]

GREEN, ORANGE, BLUE, GREY = (0.2, 0.9, 0.3), (1.0, 0.6, 0.1), (0.3, 0.6, 1.0), (0.7, 0.7, 0.7)
UNSEEN = (0.2, 0.2, 0.25)
"""The rim of what was not seen; an inner rim is that of a hole in it."""
_WHITE, _DARK = (1.0, 1.0, 1.0), (0.1, 0.13, 0.17)
_NUMBER_PX, _BEHIND_NUMBER = 14.0, 0.7


def annotated(found: Detections, seen_ns: int) -> ImageAnnotations:
    """Rectangles, that of the best grasp green, the outlines of the masks, and all things.

    Args:
        seen_ns: stamp of the image, UTC.
    """
    message = ImageAnnotations()
    best = found.grasps[0].rectangle if found.grasps else None
    for index, rectangle in enumerate(found.rectangles):
        _add_loop(message, rectangle.corners_px(), GREEN if index == best else BLUE, seen_ns)
    for mask, color in ((found.evidence.object_mask, ORANGE), (found.evidence.goal_rod_mask, GREY)):
        for outline in _outlines(mask):
            _add_loop(message, outline, color, seen_ns)
    _add_things(message, found.scene, seen_ns)
    return message


def with_things(scene: ObservedScene, seen_ns: int) -> ImageAnnotations:
    """Return the things alone."""
    message = ImageAnnotations()
    _add_things(message, scene, seen_ns)
    return message


def color_message(color: Rgb, alpha: float = 1.0) -> Color:
    """A colour, each part from 0 to 1, in Foxglove's words."""
    return Color(r=color[0], g=color[1], b=color[2], a=alpha)


def _add_things(message: ImageAnnotations, scene: ObservedScene, seen_ns: int) -> None:
    """Add the rims of what was not seen; the outline of every thing, in the colour of its number, and the number."""
    for rim in unseen_px(scene):
        _add_loop(message, rim, UNSEEN, seen_ns)
    for one in scene.instances:
        red, green, blue = (part / 255 for part in color_of(one.number))
        for outline in outlines_px(scene.labels == one.number):
            _add_loop(message, outline, (red, green, blue), seen_ns)
    for number, (u, v) in places_px(scene.labels, [one.number for one in scene.instances]).items():
        text = message.texts.add(timestamp=stamp(seen_ns), text=str(number), font_size=_NUMBER_PX)
        text.position.x, text.position.y = float(u), float(v)
        text.text_color.CopyFrom(color_message(_WHITE))
        text.background_color.CopyFrom(color_message(_DARK, _BEHIND_NUMBER))


def _add_loop(message: ImageAnnotations, corners_px: npt.NDArray[Any], color: Rgb, seen_ns: int) -> None:
    loop = message.points.add(
        timestamp=stamp(seen_ns), type=PointsAnnotation.LINE_LOOP, outline_color=color_message(color), thickness=2.0
    )
    for u, v in corners_px:
        loop.points.add(x=float(u), y=float(v))


def _outlines(mask: Mask) -> list[npt.NDArray[np.int32]]:
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    return [contour.reshape(-1, 2) for contour in contours if len(contour) > 2]
