"""Visualisation of a cycle: the results of its stages in Foxglove's message types. Frames: docs/frames.md.

The messages are published right after the result they show, and recorded like everything else on the bus: a live
viewer and a viewer of the recording show the same, without a plug-in.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from bus import topics
from bus.arrays import Joints, Transform
from bus.commands import Event
from bus.frozen import Message
from bus.messages import Detections, Grasp, ObservedScene, PickPlan, Segment, StageRecord, View
from bus.sensor_codec import stamp
from bus.topics import Topic
from bus.transforms import apply, to_wxyz
from config.franka_hand import FINGER_LENGTH_M, FINGER_TIP_M, FINGER_TIP_SIZE_M
from logs.direction import direction_in_words
from logs.image_annotations import BLUE, GREEN, GREY, ORANGE, annotated, color_message, with_things
from logs.scene_picture import draw_scene

_logger = logging.getLogger(__name__)

Array = npt.NDArray[Any]
Drawn = tuple[Topic, bytes]

_FINGER_M, _PALM_M = (*FINGER_TIP_SIZE_M, FINGER_LENGTH_M), (0.03, 0.12, 0.02)
"""A simplified hand, in the tcp's axes."""
_PATH_STEP = 40  # of the 1 kHz samples
_PLAIN = 128
_LEVEL = {"info": Log.INFO, "warning": Log.WARNING, "error": Log.ERROR}


def pictures(of: Callable[[Message | bytes], Iterable[Drawn]], message: Message | bytes) -> list[Drawn]:
    """Return the messages that ``of`` draws of a message; an error is logged, so that the publisher never fails."""
    drawn: list[Drawn] = []
    try:
        drawn.extend(of(message))
    except Exception as error:  # a result may hold any value, and the libraries raise any error for it
        name = type(message).__name__
        _logger.warning("cannot draw a %s", name, exc_info=error)
        drawn.append(_log("warning", "VIEW", f"A picture of {name} cannot be drawn: {type(error).__name__}: {error}"))
    return drawn


class Views:
    """Draws results as Foxglove messages.

    Args:
        base_from_tcp: the arm's forward kinematics: (joints,) [rad] to (4, 4).
    """

    def __init__(self, base_from_tcp: Callable[[Joints], Transform]) -> None:
        self._base_from_tcp = base_from_tcp
        self._looks_ns: list[int] = []
        self._shown = 0
        self._found: Detections | None = None

    @property
    def _seen_ns(self) -> int:
        """The stamp of the look that is shown, UTC: there, `topics.TF` says where its frame ``color`` is."""
        return self._looks_ns[self._shown] if self._shown < len(self._looks_ns) else 0

    def of(self, message: Message | bytes) -> Iterator[Drawn]:
        """Yield the Foxglove messages of one message; none for most kinds."""
        if isinstance(message, Event):
            yield _log(message.severity, message.code, f"{message.text} {message.advice}".strip())
        if isinstance(message, ObservedScene):
            yield from self._seen(message)
        if not isinstance(message, StageRecord):
            return
        if message.failure is not None:
            yield _log("error", message.stage, f"{message.failure.code}: {message.failure.text}")
            return
        result = message.result
        yield _log("info", message.stage, f"{_looked_again(result)}done in {message.duration_s:.2f} s")
        if isinstance(result, View):
            self._looks_ns = [*(self._looks_ns if result.why else ()), result.stamp_ns]
            self._found = None
        elif isinstance(result, Detections):
            self._found = result
            self._shown = result.scene.shown
            yield from self._detected(result)
        elif isinstance(result, PickPlan) and self._found is not None:
            yield topics.VIEW_SCENE, self._planned(result, self._found.grasps[result.grasp]).SerializeToString()

    def _detected(self, found: Detections) -> Iterator[Drawn]:
        seen = found.evidence
        yield topics.VIEW_COLOR, self._image(seen.color)
        yield topics.VIEW_GOAL, self._image(seen.goal_image)
        yield topics.VIEW_ANNOTATIONS, annotated(found, self._seen_ns).SerializeToString()
        yield topics.VIEW_CLOUD, self._cloud(seen.observed_points).SerializeToString()
        scene = SceneUpdate()
        rod = self._entity(scene, "rod", "color")
        _line(rod, np.asarray(seen.rod_ends), ORANGE, thickness_m=0.004)
        grasps = self._entity(scene, "grasps", "base")
        for grasp in found.grasps:
            half = 0.5 * grasp.opening_m * grasp.base_from_tcp[:3, 1]
            middle = grasp.base_from_tcp[:3, 3]
            _line(grasps, np.stack([middle - half, middle + half]), BLUE, alpha=max(0.2, min(1.0, grasp.score)))
        yield topics.VIEW_SCENE, scene.SerializeToString()

    def _seen(self, scene: ObservedScene) -> Iterator[Drawn]:
        """Yield what a failed detection saw: on grey, since the image itself is not in the message."""
        self._shown = scene.shown
        plain = np.full((*scene.labels.shape, 3), _PLAIN, dtype=np.uint8)
        yield topics.VIEW_COLOR, self._image(draw_scene(plain, scene))
        yield topics.VIEW_ANNOTATIONS, with_things(scene, self._seen_ns).SerializeToString()

    def _planned(self, plan: PickPlan, grasp: Grasp) -> SceneUpdate:
        scene = SceneUpdate()
        _gripper(self._entity(scene, "gripper", "base"), grasp)
        for segment in plan.segments:
            path = self._entity(scene, f"path/{segment.name}", "base")
            _line(path, self._tcp_path(segment), GREEN if segment.name == "reach" else GREY)
        return scene

    def _tcp_path(self, segment: Segment) -> Array:
        """Path (n, 3) [m] of the tcp in ``base``."""
        q_rad = segment.trajectory.raw_q_rad
        return np.array([self._base_from_tcp(q)[:3, 3] for q in (*q_rad[::_PATH_STEP], q_rad[-1])])

    def _entity(self, scene: SceneUpdate, name: str, frame: str) -> SceneEntity:
        entity: SceneEntity = scene.entities.add(id=name, frame_id=frame, timestamp=stamp(self._seen_ns))
        return entity

    def _image(self, pixels: Array) -> bytes:
        is_drawn, jpeg = cv2.imencode(".jpg", pixels[..., ::-1])
        if not is_drawn:
            raise ValueError(f"no JPEG of an image of shape {pixels.shape}")
        image = CompressedImage(timestamp=stamp(self._seen_ns), frame_id="color", data=jpeg.tobytes(), format="jpeg")
        return bytes(image.SerializeToString())

    def _cloud(self, points: Array) -> PointCloud:
        """A point cloud of points (n, 3) [m] in ``color``."""
        packed = np.ascontiguousarray(points, "<f4")
        cloud = PointCloud(timestamp=stamp(self._seen_ns), frame_id="color", point_stride=12, data=packed.tobytes())
        cloud.pose.orientation.w = 1.0
        for offset, name in enumerate("xyz"):
            cloud.fields.add(name=name, offset=4 * offset, type=PackedElementField.FLOAT32)
        return cloud


def _looked_again(result: object) -> str:
    """From where and why a further look was taken; "" for anything else."""
    if not isinstance(result, View) or not result.why:
        return ""
    return f"another look, {direction_in_words(result.base_from_color)}: {result.why}; "


def _log(severity: str, name: str, text: str) -> Drawn:
    printable = text.encode(errors="backslashreplace").decode()
    said = Log(timestamp=stamp(time.time_ns()), level=_LEVEL[severity], name=name, message=printable)
    return topics.VIEW_LOG, said.SerializeToString()


def _line(
    entity: SceneEntity,
    points: Array,
    color: tuple[float, float, float],
    *,
    thickness_m: float = 0.002,
    alpha: float = 1.0,
) -> None:
    line = entity.lines.add(type=LinePrimitive.LINE_STRIP, thickness=thickness_m, color=color_message(color, alpha))
    line.pose.orientation.w = 1.0
    line.points.extend(Point3(x=float(x), y=float(y), z=float(z)) for x, y, z in points)


def _gripper(entity: SceneEntity, grasp: Grasp) -> None:
    """Add the palm and the two fingers, opened as for the approach."""
    apart = 0.5 * (grasp.opening_m + _FINGER_M[1])
    behind = FINGER_TIP_M - 0.5 * FINGER_LENGTH_M
    palm = (0.0, 0.0, FINGER_TIP_M - FINGER_LENGTH_M - 0.5 * _PALM_M[2])
    for size, center in ((_FINGER_M, (0.0, apart, behind)), (_FINGER_M, (0.0, -apart, behind)), (_PALM_M, palm)):
        cube = entity.cubes.add(color=color_message(GREEN, 0.6))
        cube.size.x, cube.size.y, cube.size.z = size
        x, y, z = apply(grasp.base_from_tcp, np.array(center))
        cube.pose.position.x, cube.pose.position.y, cube.pose.position.z = float(x), float(y), float(z)
        q = cube.pose.orientation
        q.w, q.x, q.y, q.z = to_wxyz(grasp.base_from_tcp)
