"""Videos of pictures that stand still: each is encoded once, as a key frame, and held by frames that change nothing.

Those are the same for every picture, all blocks of them skipped, so that they too are encoded once. A long hold repeats
the key frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from logs.export.clock import Array
from logs.export.packages import av

GROUP = 10
"""Frames from one key frame to the next: a reader that wants any of them decodes no more than these."""
DEPTH_MIN_M, DEPTH_MAX_M, DEPTH_SHIFT_M = 0.01, 10.0, 3.5
_DEPTH_CODES = 4095


@dataclass(frozen=True)
class Format:
    """How a camera's pictures are encoded. ``given``: pixel format of the arrays. ``options``: of the encoder."""

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
    """The depth (h, w) [m] behind `depth_codes`; NaN = not measured."""
    low, high = np.log(DEPTH_MIN_M + DEPTH_SHIFT_M), np.log(DEPTH_MAX_M + DEPTH_SHIFT_M)
    metres = np.exp(codes / _DEPTH_CODES * (high - low) + low) - DEPTH_SHIFT_M
    return np.asarray(np.where(codes == 0, np.nan, metres))


class Video:
    """One MP4 file; its frames lie on the grid of ``fps``.

    Args:
        path: of the new file. ``shape``: (height, width) of all pictures [px].
    """

    def __init__(self, path: Path, fps: int, shape: tuple[int, int], form: Format) -> None:
        self._form = form
        self._frames = self._bytes = self._given = 0
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = av.open(str(path), "w", format="mp4")
        self._stream = self._file.add_stream(form.encoder, rate=fps, options=form.options)
        self._stream.height, self._stream.width = shape
        self._stream.pix_fmt = form.pix_fmt
        self._stream.gop_size = GROUP
        self._stream.codec_context.thread_count = 1
        black = np.zeros(
            (*shape, form.channels) if form.channels > 1 else shape, np.uint16 if form is DEPTH else np.uint8
        )
        group = [self._encoded(black, is_key=number == 0) for number in range(GROUP)]
        self._unchanged = group[1:]

    @property
    def frames(self) -> int:
        """How many it has so far."""
        return self._frames

    @property
    def size_bytes(self) -> int:
        """How large its frames are so far."""
        return self._bytes

    def hold(self, picture: Array, frames: int) -> None:
        """Add so many frames that show one picture (H, W, 3) or (H, W)."""
        key = self._encoded(picture, is_key=True)
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

    def _encoded(self, picture: Array, *, is_key: bool) -> bytes:
        """One frame; the encoder gives its packet at once."""
        frame: Any = av.VideoFrame.from_ndarray(picture, format=self._form.given).reformat(format=self._form.pix_fmt)
        kind = av.video.frame.PictureType
        frame.pts, frame.pict_type = self._given, kind.I if is_key else kind.P
        self._given += 1
        packets = self._stream.encode(frame)
        if len(packets) != 1 or packets[0].is_keyframe is not is_key:
            raise RuntimeError(f"{self._form.encoder} gave {packets} for one frame")
        return bytes(packets[0])
