"""The state of the camera stand-in: its clock, its properties, and the newest pair of images."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import cv2
import numpy as np

from drivers.sim.optics import COLOR, COLOR_FROM_DEPTH, DEPTH

SERIAL = "CL2X00000001"
_PRODUCT = 0x0669


@dataclass(frozen=True)
class Exposure:
    """One synchronised capture.

    Attributes:
        color: (720, 1280, 3) RGB. ``depth_mm``: (576, 640) uint16, 0 = invalid.
        taken_s: `time.monotonic` of the middle of the exposure.
    """

    color: np.ndarray
    depth_mm: np.ndarray
    taken_s: float


@dataclass(frozen=True)
class Pair:
    """An exposure as it travels."""

    number: int
    stamp_us: int
    depth: bytes
    jpeg: bytes


@dataclass
class Device:
    """State shared by the stand-in's servers; faults are set from outside."""

    frozen: bool = False
    clock_offset_us: int = 5_000_000_000
    truncate: int = 0
    drop: int = 0
    ints: dict[int, int] = field(default_factory=lambda: {111: _PRODUCT})
    structs: dict[int, bytes] = field(default_factory=dict)
    news: threading.Condition = field(default_factory=threading.Condition)
    newest: Pair | None = None

    def clock_us(self, monotonic_s: float) -> int:
        return self.clock_offset_us + int(monotonic_s * 1e6)

    def expose(self, exposures: Iterator[Exposure]) -> None:
        """Publish every exposure of the source, for ever."""
        encoded: tuple[object, bytes] = (None, b"")
        for number, exposure in enumerate(exposures):
            if encoded[0] is not exposure.color:  # a still scene is encoded once
                encoded = (exposure.color, cv2.imencode(".jpg", exposure.color[..., ::-1])[1].tobytes())
            jpeg = encoded[1]
            if self.truncate > 0:
                self.truncate -= 1
                jpeg = jpeg[: len(jpeg) // 2]
            if self.drop > 0:
                self.drop -= 1
                continue
            # the device stamps the start of the exposure, 6.4 ms before its middle
            stamp_us = self.clock_us(exposure.taken_s - 0.0064)
            with self.news:
                self.newest = Pair(number, stamp_us, exposure.depth_mm.astype("<u2").tobytes(), jpeg)
                self.news.notify_all()

    def after(self, number: int, patience_s: float = 0.5) -> Pair | None:
        """The newest pair if it is newer than ``number``, waited for."""
        with self.news:
            self.news.wait_for(lambda: self.newest is not None and self.newest.number > number, patience_s)
            pair = self.newest
        return pair if pair is not None and pair.number > number and not self.frozen else None

    def struct_of(self, number: int) -> bytes | None:
        """A property's bytes, or None when there is no such property."""
        if number == 1000:
            texts = ("1.3.1", "1.0", "2.9.3", "1.0", "1.0", SERIAL)
            head = b"".join(text.encode().ljust(16, b"\0") for text in texts)
            return head + struct.pack("<i", 3) + b"Femto Mega".ljust(16, b"\0") + bytes(16) + bytes(32)
        if number == 1003:
            return struct.pack("<11f", 51.0, 42.5, 40.25, *[0.0] * 8)
        if number == 1035:
            return SERIAL.encode().ljust(32, b"\0")
        if number == 1037:
            return struct.pack("<QQ", self.clock_us(time.monotonic()), 0)
        if number == 1038:
            return self.structs.get(1038, struct.pack("<i6H", 1, 0, 0, 0, 0, 0, 0))
        return self.structs.get(number)

    def raw(self, number: int) -> bytes | None:
        """A long property: the profile, calibration and alignment lists."""
        lists = {4033: _profiles, 4027: _calibration, 4024: _alignments}
        return lists[number]() if number in lists else None


def _profiles() -> bytes:
    depth = [(3, 640, 576, fps, b"Y16 ") for fps in (30, 15, 5)]
    color = [(2, *size, fps, b"MJPG") for size in ((1920, 1080), (1280, 720)) for fps in (30, 15, 5)]
    items = [
        struct.pack("<H4I", sensor, width, height, fps, int.from_bytes(code, "big"))
        for sensor, width, height, fps, code in (*depth, *color)
    ]
    return struct.pack("<HH", 18, len(items)) + b"".join(items)


def _intrinsics(camera: object) -> bytes:
    c = camera
    return struct.pack("<4f2h", c.fx, c.fy, c.cx, c.cy, c.width, c.height)  # type: ignore[attr-defined]


def _distortion(camera: object) -> bytes:
    k1, k2, p1, p2, k3, k4, k5, k6 = camera.distortion  # type: ignore[attr-defined]
    return struct.pack("<8f", k1, k2, k3, k4, k5, k6, p1, p2)


def _calibration() -> bytes:
    rotation, shift_mm = COLOR_FROM_DEPTH[:3, :3].ravel(), COLOR_FROM_DEPTH[:3, 3] * 1000
    item = _intrinsics(DEPTH) + _intrinsics(COLOR) + _distortion(DEPTH) + _distortion(COLOR)
    item += struct.pack("<12f", *rotation, *shift_mm)
    return item.ljust(176, b"\0")


def _alignments() -> bytes:
    return struct.pack("<4HBBf4h", 1280, 720, 640, 576, 2, 0, 1.0, 0, 0, 0, 0)
