"""Writes a recording that Orbbec's SDK plays back: a ROS 1 bag (v2.0) with the SDK's own messages."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from bus.messages import CameraModel

_MAGIC = b"#ROSBAG V2.0\n"
_ANY = "0123456789abcdef0123456789abcdef"
_IMAGE = "060021388200f6f0f447d0fcd9c64743"
_DEVICE = "afef5328bb4abebd1a309e1ea8b26b3a"
_DEPTH, _COLOR = 3, 2
_Y16, _MJPG = 8, 5
_FPS = 30
_START_NS = 1_000_000_000


@dataclass
class _Connection:
    number: int
    topic: str
    kind: str
    md5: str

    def record(self) -> bytes:
        data = _fields(topic=self.topic, type=self.kind, md5sum=self.md5, message_definition="-")
        return _record(_fields(op=b"\x07", topic=self.topic, conn=struct.pack("<I", self.number)), data)


@dataclass
class _Bag:
    """One uncompressed chunk."""

    connections: dict[str, _Connection] = field(default_factory=dict)
    chunk: bytes = b""
    index: dict[int, list[tuple[bytes, int]]] = field(default_factory=dict)

    def add(self, topic: str, kind: str, md5: str, at_ns: int, payload: bytes) -> None:
        if topic not in self.connections:
            self.connections[topic] = _Connection(len(self.connections), topic, kind, md5)
            self.chunk += self.connections[topic].record()
        number = self.connections[topic].number
        self.index.setdefault(number, []).append((_time(at_ns), len(self.chunk)))
        header = struct.pack("<III", 0, at_ns // 10**9, at_ns % 10**9) + _text("")
        fields = _fields(op=b"\x02", conn=struct.pack("<I", number), time=_time(at_ns))
        self.chunk += _record(fields, header + payload)

    def write(self, path: Path) -> None:
        chunk = _record(_fields(op=b"\x05", compression="none", size=struct.pack("<I", len(self.chunk))), self.chunk)
        times = sorted(at for entries in self.index.values() for at, _ in entries)
        body = chunk
        for number, entries in self.index.items():
            head = _fields(op=b"\x04", ver=_u32(1), conn=_u32(number), count=_u32(len(entries)))
            body += _record(head, b"".join(at + _u32(offset) for at, offset in entries))
        start = len(_MAGIC) + 4096 + 8
        tail = b"".join(connection.record() for connection in self.connections.values())
        info = _fields(op=b"\x06", ver=_u32(1), chunk_pos=struct.pack("<Q", start), start_time=times[0],
                       end_time=times[-1], count=_u32(len(self.index)))  # fmt: skip
        counts = b"".join(_u32(number) + _u32(len(entries)) for number, entries in self.index.items())
        head = _fields(op=b"\x03", index_pos=struct.pack("<Q", start + len(body)),
                       conn_count=_u32(len(self.connections)), chunk_count=_u32(1))  # fmt: skip
        path.write_bytes(_MAGIC + _record(head, b" " * (4096 - len(head))) + body + tail + _record(info, counts))


def write_bag(
    path: Path,
    pairs: Sequence[tuple[np.ndarray, np.ndarray]],
    color_camera: CameraModel,
    depth_camera: CameraModel,
    color_from_depth: np.ndarray,
) -> None:
    """A recording of (colour RGB, depth mm) pairs at 30 Hz.

    Args:
        pairs: colour (H, W, 3) uint8 and depth (h, w) uint16.
    """
    bag = _Bag()
    bag.add("/cam/property", "custom_msg/OBProperty", _ANY, _START_NS, _property(0, struct.pack("<d", 2.1)))
    for number, (color, depth_mm) in enumerate(pairs):
        at_ns = _START_NS + number * 10**9 // _FPS
        jpeg = cv2.imencode(".jpg", color[..., ::-1])[1].tobytes()
        for stream, image in (
            (_DEPTH, _image(depth_mm.shape, "mono16", depth_mm.astype("<u2").tobytes(), 16, number, at_ns)),
            (_COLOR, _image(color.shape[:2], "mjpg", jpeg, 8, number, at_ns)),
        ):
            bag.add(f"/cam/sensor_{stream}/frameType_{stream}", "sensor_msgs/Image", _IMAGE, at_ns, image)
    bag.add("/cam/deviceInfo", "custom_msg/OBDeviceInfo", _DEVICE, _START_NS, _device())
    for stream, encoding, camera, pose in (
        (_DEPTH, _Y16, depth_camera, color_from_depth),
        (_COLOR, _MJPG, color_camera, np.zeros((4, 4))),
    ):
        topic = f"/cam/streamProfileType_{stream}"
        profile = _profile(stream, encoding, camera, pose)
        bag.add(topic, "custom_msg/OBStreamProfileInfo", _ANY, _START_NS, profile)
    bag.write(path)


def _property(number: int, data: bytes) -> bytes:
    return _u32(number) + _bytes(data) + _u32(len(data))


def _image(shape: tuple[int, ...], encoding: str, data: bytes, bits: int, number: int, at_ns: int) -> bytes:
    height, width = shape
    step = 2 * width if bits == 16 else 0
    stamps = struct.pack("<4Q", number, at_ns // 1000, at_ns // 1000, 0)
    return (
        struct.pack("<II", height, width) + _text(encoding) + b"\0" + _u32(step) + _bytes(data)
        + struct.pack("<f", 0.0) + stamps + _bytes(b"") + _u32(0) + bytes([bits])
    )  # fmt: skip


def _device() -> bytes:
    names = _text("Femto Mega") + _text("Orbbec Femto Mega") + _text("Mega")
    rest = (_text(text) for text in ("uid", "CL2X00000001", "1.3.1", "1.0", "2.9.3", "Ethernet"))
    numbers = struct.pack("<HH", 0x2BC5, 0x0669)
    return names + numbers + b"".join(rest) + struct.pack("<HB", 0x0669, 0) + _text("127.0.0.1") + _text("")


def _profile(stream: int, encoding: int, camera: CameraModel, pose: np.ndarray) -> bytes:
    k1, k2, p1, p2, k3, k4, k5, k6 = camera.distortion
    return (
        struct.pack("<BB", stream, encoding)
        + struct.pack("<12f", *pose[:3, :3].ravel(), *(pose[:3, 3] * 1000))
        + struct.pack("<3H", camera.width, camera.height, _FPS)
        + struct.pack("<4f", camera.fx, camera.fy, camera.cx, camera.cy)
        + struct.pack("<8fB", k1, k2, k3, k4, k5, k6, p1, p2, 4)
    )


def _fields(**values: bytes | str) -> bytes:
    parts = (name.encode() + b"=" + (v.encode() if isinstance(v, str) else v) for name, v in values.items())
    return b"".join(_bytes(part) for part in parts)


def _record(fields: bytes, data: bytes) -> bytes:
    return _bytes(fields) + _bytes(data)


def _bytes(data: bytes) -> bytes:
    return _u32(len(data)) + data


def _text(text: str) -> bytes:
    return _bytes(text.encode())


def _u32(value: int) -> bytes:
    return struct.pack("<I", value)


def _time(at_ns: int) -> bytes:
    return struct.pack("<II", at_ns // 10**9, at_ns % 10**9)
