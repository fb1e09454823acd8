"""Videos of pictures that stand still: each is encoded once, as a key frame, and held by frames that change nothing.

Those are the same for every picture, all blocks of them skipped, so that they too are encoded once. A long hold repeats
the key frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from logs.export.clock import Array
from logs.export.packages import av

GROUP = 10
"""Frames from one key frame to the next: a reader that wants any of them decodes no more than these."""
DEPTH_MIN_M, DEPTH_MAX_M, DEPTH_SHIFT_M = 0.01, 10.0, 3.5
_DEPTH_CODES = 4095
_ANY_FPS = 10
"""An encoder wants to be told; a key frame is the same at any rate."""


@dataclass(frozen=True)
class Format:
    """The encoding of a camera's pictures. ``given``: pixel format of the arrays. ``options``: of the encoder."""

    encoder: str
    codec: str
    pix_fmt: str
    given: str
    channels: int
    options: dict[str, str]


COLOR = Format(
    "libx264",
    "h264",
    "yuv420p",
    "rgb24",
    3,
    {"preset": "ultrafast", "tune": "zerolatency", "qp": "20", "forced-idr": "1", "sc_threshold": "0"},
)
_X265 = "lossless=1:bframes=0:rc-lookahead=0:scenecut=0:open-gop=0:frame-threads=1:pools=none:ctu=16:log-level=none"
DEPTH = Format(
    "libx265",
    "hevc",
    "gray12le",
    "gray12le",
    1,
    {"preset": "ultrafast", "tune": "zerolatency", "forced-idr": "1", "x265-params": _X265},
)


def depth_codes(depth_m: Array) -> Array:
    """Depth (h, w) [m] as LeRobot's 12 bits, logarithmic from `DEPTH_MIN_M` to `DEPTH_MAX_M`; 0 = not measured."""
    low, high = np.log(DEPTH_MIN_M + DEPTH_SHIFT_M), np.log(DEPTH_MAX_M + DEPTH_SHIFT_M)
    share = (np.log(np.nan_to_num(depth_m, nan=0.0) + np.float32(DEPTH_SHIFT_M)) - low) / (high - low)
    return np.asarray(np.rint(share * _DEPTH_CODES).clip(0, _DEPTH_CODES).astype(np.uint16))


def depth_m(codes: Array) -> Array:
    """Return the depth (h, w) [m] behind `depth_codes`; NaN = not measured."""
    low, high = np.log(DEPTH_MIN_M + DEPTH_SHIFT_M), np.log(DEPTH_MAX_M + DEPTH_SHIFT_M)
    metres = np.exp(codes / _DEPTH_CODES * (high - low) + low) - DEPTH_SHIFT_M
    return np.asarray(np.where(codes == 0, np.nan, metres))


class KeyFrames:
    """Encodes pictures, each as a key frame of its own, for a `Video` of the same shape and format."""

    def __init__(self, shape: tuple[int, int], form: Format) -> None:
        self._form, self._given = form, 0
        self._codec = av.CodecContext.create(form.encoder, "w")
        _prepare(self._codec, shape, form)
        self._codec.time_base, self._codec.framerate = Fraction(1, _ANY_FPS), Fraction(_ANY_FPS)
        self._codec.flags |= av.codec.context.Flags.global_header  # as in the file

    def encoded(self, picture: Array) -> bytes:
        """One picture (H, W, 3) or (H, W)."""
        self._given += 1
        return _encoded(self._codec, picture, self._form, self._given - 1, is_key=True)


class Video:
    """One MP4 file; its frames lie on the grid of ``fps``.

    Args:
        path: of the new file. ``shape``: (height, width) of all pictures [px].
    """

    def __init__(self, path: Path, fps: int, shape: tuple[int, int], form: Format) -> None:
        self._frames = self._bytes = 0
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = av.open(str(path), "w", format="mp4")
        self._stream = self._file.add_stream(form.encoder, rate=fps, options=form.options)
        _prepare(self._stream.codec_context, shape, form)
        black = np.zeros(
            (*shape, form.channels) if form.channels > 1 else shape, np.uint16 if form is DEPTH else np.uint8
        )
        codec = self._stream.codec_context
        self._unchanged = [_encoded(codec, black, form, at, is_key=at == 0) for at in range(GROUP)][1:]

    @property
    def frames(self) -> int:
        """The number of frames that it has so far."""
        return self._frames

    @property
    def size_bytes(self) -> int:
        """The size of its frames so far."""
        return self._bytes

    def hold(self, key: bytes, frames: int) -> None:
        """Add so many frames that show one picture, by its key frame of `KeyFrames`."""
        for number in range(frames):
            place = number % GROUP
            packet = av.Packet(self._unchanged[place - 1] if place else key)
            packet.stream, packet.time_base = self._stream, self._stream.codec_context.time_base
            packet.pts = packet.dts = self._frames + number
            packet.duration, packet.is_keyframe = 1, place == 0
            self._bytes += packet.size
            self._file.mux(packet)
        self._frames += frames

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


def _prepare(codec: Any, shape: tuple[int, int], form: Format) -> None:
    codec.height, codec.width = shape
    codec.pix_fmt, codec.options = form.pix_fmt, form.options
    codec.gop_size, codec.thread_count = GROUP, 1


def _encoded(codec: Any, picture: Array, form: Format, number: int, *, is_key: bool) -> bytes:
    """One frame; the encoder gives its packet at once."""
    frame: Any = av.VideoFrame.from_ndarray(picture, format=form.given).reformat(format=form.pix_fmt)
    kind = av.video.frame.PictureType
    frame.pts, frame.pict_type = number, kind.I if is_key else kind.P
    packets = codec.encode(frame)
    if len(packets) != 1 or packets[0].is_keyframe is not is_key:
        raise RuntimeError(f"{form.encoder} gave {packets} for one frame")
    return bytes(packets[0])
