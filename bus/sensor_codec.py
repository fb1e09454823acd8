"""Converts sensor data to Foxglove's protobuf messages and back.

The stages work on the decoded data, so a recording of the bytes replays bit for bit. Frames and units: docs/frames.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError
from google.protobuf.timestamp_pb2 import Timestamp
from scipy.spatial.transform import Rotation

from bus import topics
from bus.arrays import ARM_JOINTS, Joints
from bus.errors import BadPayload
from bus.messages import ArmState, CameraModel, Frame
from bus.messages.frame_checks import LENSES
from bus.picture_header import require_picture
from bus.transforms import from_wxyz

_JPEG_QUALITY = 95
_FR3_JOINTS = 7
_YEAR_10000_S = 253_402_300_800


def stamp(stamp_ns: int) -> Timestamp:
    """Convert integer nanoseconds UTC to a protobuf timestamp."""
    return Timestamp(seconds=stamp_ns // 1_000_000_000, nanos=stamp_ns % 1_000_000_000)


def stamp_ns(timestamp: Timestamp) -> int:
    """Convert a protobuf timestamp to integer nanoseconds UTC. Raises: BadPayload outside the years 1970 to 9999."""
    if not (0 <= timestamp.seconds < _YEAR_10000_S and 0 <= timestamp.nanos < 1_000_000_000):
        raise BadPayload(f"A time of {timestamp.seconds} s and {timestamp.nanos} ns is none.")
    return int(timestamp.seconds) * 1_000_000_000 + int(timestamp.nanos)


def frame_to_wire(frame: Frame) -> dict[str, bytes]:
    """Return a frame as the five payloads of `topics.FRAME_PARTS`, by topic key.

    Colour becomes JPEG; depth becomes 16-bit millimetres, 0 = invalid. Raises: BadPayload if encoding fails.
    """
    when = stamp(frame.stamp_ns)
    ok, jpeg = cv2.imencode(".jpg", frame.color[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    if not ok:
        raise BadPayload(f"Cannot encode a colour image of shape {frame.color.shape}.")
    depth_mm = np.nan_to_num(frame.depth_m * 1000.0, nan=0.0).round().clip(0, 65535).astype("<u2")
    height, width = depth_mm.shape
    parts = {
        topics.CAMERA_COLOR: CompressedImage(timestamp=when, frame_id="color", data=jpeg.tobytes(), format="jpeg"),
        topics.CAMERA_DEPTH: RawImage(
            timestamp=when,
            frame_id="depth",
            width=width,
            height=height,
            encoding="16UC1",
            step=2 * width,
            data=depth_mm.tobytes(),
        ),
        topics.CAMERA_COLOR_CALIBRATION: _calibration(frame.color_camera, "color", when),
        topics.CAMERA_DEPTH_CALIBRATION: _calibration(frame.depth_camera, "depth", when),
        topics.CAMERA_TF: transforms_to_wire({("color", "depth"): frame.color_from_depth}, frame.stamp_ns),
    }
    return {topic.key: message.SerializeToString() for topic, message in parts.items()}


def frame_from_wire(parts: Mapping[str, bytes]) -> Frame:
    """Return the frame behind the five payloads.

    Raises:
        BadPayload: one of them is missing or broken, or they do not fit together.
        BadFrame: they can be read, and are no frame all the same: another unit, a baseline of metres.
    """
    missing = [topic.key for topic in topics.FRAME_PARTS if topic.key not in parts]
    if missing:
        raise BadPayload(f"A frame needs {', '.join(missing)}.")
    try:
        return _frame(*(topic.says.FromString(parts[topic.key]) for topic in topics.FRAME_PARTS))
    except (DecodeError, cv2.error, IndexError, ValueError) as error:  # protobuf fields may be empty
        raise BadPayload(f"Broken camera payload: {' '.join(str(error).split())}.") from error


def _frame(color: Any, depth: Any, color_camera: Any, depth_camera: Any, tf: Any) -> Frame:
    stamps = {stamp_ns(part.timestamp) for part in (color, depth, color_camera, depth_camera)}
    if len(stamps) != 1:
        raise BadPayload("Colour, depth and calibration of one frame carry different stamps.")
    sizes_px = require_picture(color.data), (depth.width, depth.height)
    for camera, size_px, name in zip((color_camera, depth_camera), sizes_px, ("colour", "depth"), strict=True):
        if (camera.width, camera.height) != size_px or 0 in size_px:
            wanted = f"{camera.width} x {camera.height}"
            raise BadPayload(f"The {name} image has {size_px[0]} x {size_px[1]} pixels, its calibration says {wanted}.")
    pixels = cv2.imdecode(np.frombuffer(color.data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if pixels is None or depth.encoding != "16UC1" or len(depth.data) != depth.height * depth.width * 2:
        raise BadPayload("A colour or depth image does not decode.")
    depth_mm = np.frombuffer(depth.data, "<u2").reshape(depth.height, depth.width)
    return Frame(
        stamp_ns=stamps.pop(),
        color=np.ascontiguousarray(pixels[..., ::-1]),
        depth_m=np.where(depth_mm == 0, np.nan, depth_mm / 1000.0),
        color_camera=_camera_model(color_camera),
        depth_camera=_camera_model(depth_camera),
        color_from_depth=_matrix(tf.transforms[0]),
    )


def _calibration(camera: CameraModel, frame_id: str, when: Timestamp) -> CameraCalibration:
    intrinsics = [camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1]
    return CameraCalibration(
        timestamp=when,
        frame_id=frame_id,
        width=camera.width,
        height=camera.height,
        distortion_model="rational_polynomial" if camera.distortion else "",
        D=camera.distortion,
        K=intrinsics,
        R=np.eye(3).ravel(),
        P=[camera.fx, 0, camera.cx, 0, 0, camera.fy, camera.cy, 0, 0, 0, 1, 0],
    )


def _camera_model(message: CameraCalibration) -> CameraModel:
    k = message.K
    fits = np.isfinite([*k, *message.D]).all() and min(k[0], k[4]) > 0 and len(message.D) in LENSES
    if not fits:
        raise BadPayload(f"The calibration of {message.frame_id!r} is none of a camera.")
    return CameraModel(
        width=message.width, height=message.height, fx=k[0], fy=k[4], cx=k[2], cy=k[5], distortion=tuple(message.D)
    )


# --- transforms and joints --------------------------------------------------------------------------------------------


def transforms_to_wire(parent_from_child: Mapping[tuple[str, str], npt.NDArray[Any]], at_ns: int) -> FrameTransforms:
    """Return poses {(parent, child): parent_from_child (4, 4) [m]} as foxglove.FrameTransforms."""
    message = FrameTransforms()
    turns = Rotation.from_matrix(np.stack([pose[:3, :3] for pose in parent_from_child.values()]))
    quaternions = turns.as_quat(scalar_first=True).tolist()  # at once: a SciPy call costs more than its work
    for ((parent, child), pose), wxyz in zip(parent_from_child.items(), quaternions, strict=True):
        entry = message.transforms.add(timestamp=stamp(at_ns), parent_frame_id=parent, child_frame_id=child)
        entry.translation.x, entry.translation.y, entry.translation.z = pose[:3, 3].tolist()
        entry.rotation.w, entry.rotation.x, entry.rotation.y, entry.rotation.z = wxyz
    return message


def _matrix(transform: Any) -> npt.NDArray[np.float64]:
    r, t = transform.rotation, transform.translation
    try:
        return from_wxyz((r.w, r.x, r.y, r.z), (t.x, t.y, t.z))
    except ValueError as error:
        raise BadPayload(f"The transform to {transform.child_frame_id!r} is none: {error}.") from error


def arm_state_to_wire(state: ArmState) -> bytes:
    """Return an arm state as the bytes of foxglove.JointStates (effort = external torque [Nm])."""
    message = JointStates(timestamp=stamp(state.stamp_ns))
    whose = "fr3_" if len(state.q_rad) == _FR3_JOINTS else ""
    for index in range(len(state.q_rad)):
        message.joints.add(
            name=f"{whose}joint{index + 1}",
            position=state.q_rad[index],
            velocity=state.dq_rad_s[index],
            effort=state.tau_ext_nm[index],
        )
    return message.SerializeToString()


def arm_stamp_ns(payload: bytes) -> int:
    """Return the time of measurement of a published arm state [ns UTC]. Raises: BadPayload when it is none."""
    return stamp_ns(arm_joints(payload).timestamp)


def arm_q_rad(payload: bytes) -> Joints:
    """Return the measured positions (n,) of a published arm state. Raises: BadPayload when it is none or not finite."""
    q_rad = np.array([joint.position for joint in arm_joints(payload).joints])
    if not np.isfinite(q_rad).all():
        raise BadPayload("An arm state holds a position that is no number.")
    return q_rad


def arm_joints(payload: bytes) -> JointStates:
    """Parse a published arm state. Raises: BadPayload when it is none."""
    try:
        said = JointStates.FromString(payload)
    except DecodeError as error:
        raise BadPayload(f"Not an arm state: {error}.") from error
    least, most = ARM_JOINTS
    if not least <= len(said.joints) <= most:
        raise BadPayload(f"An arm state has {least} to {most} joints, not {len(said.joints)}.")
    return said
