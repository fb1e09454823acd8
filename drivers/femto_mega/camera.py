"""The Femto Mega as a `Camera`: turns its reader's newest pair into a frame. Frames: docs/frames.md."""

from __future__ import annotations

import time
from collections.abc import Callable

import cv2
import numpy as np

from bus.errors import DeviceAbsent, DeviceLost, DriverUnavailable, NotConnected, StaleFrame
from bus.messages import Frame
from config.hardware import FemtoMegaSettings
from config.schema import Station
from drivers.femto_mega.reader import READY_S, Reader, Seen
from drivers.femto_mega.session import Pair, Session
from drivers.interface import Devices

_BEYOND_S = 0.1
"""Extra wait of a capture beyond the time after which the camera counts as lost [s]."""
_FULL_SCALE = 65535
_ADVICE = "Check the camera's cable, power and node; it is connected anew by itself."
_RESTART = "Restart its node; its log has the defect."


class FemtoMega:
    """An Orbbec Femto Mega: depth 640x576 (NFOV unbinned) and colour 1280x720, both at 30 Hz and of one moment.

    Args:
        open_session: connects to the camera. Raises: DriverUnavailable.
    """

    def __init__(
        self, settings: FemtoMegaSettings, open_session: Callable[[FemtoMegaSettings], Session] = Session
    ) -> None:
        self._settings, self._open_session = settings, open_session
        self._reader: Reader | None = None

    def connect(self) -> None:
        """Open the camera, let its exposure settle and learn its clock; up to 10 s. Raises: DriverUnavailable."""
        if self._reader is not None and self._reader.is_alive():
            return
        self.close()
        reader = Reader(self._open(), self._open, self._settings)
        if reader.exposed_after(0, READY_S) is None:
            if not reader.is_alive():
                raise DriverUnavailable("The camera cannot be read: that ended by a defect.", _RESTART)
            reader.end()
            why = f" ({reader.trouble})" if reader.trouble else ""
            raise DeviceAbsent(f"The camera gave no pictures within {READY_S:.0f} s{why}.", _ADVICE)
        self._reader = reader

    def capture(self) -> Frame:
        """Return the next pair as a frame, exposed after this call.

        Raises:
            NotConnected: before `connect` and after `close`.
            StaleFrame: no usable pair came until the camera counts as lost.
            DeviceLost: the reading thread ended.
        """
        asked_ns, patience_s = time.monotonic_ns(), self._settings.lost_after_s + _BEYOND_S
        give_up_ns = asked_ns + round(patience_s * 1e9)
        reader = self._reader
        if reader is None:
            raise NotConnected("The Femto Mega is not connected.", "Call connect() first.")
        while (left_s := (give_up_ns - time.monotonic_ns()) / 1e9) > 0 and reader.is_alive():
            seen = reader.exposed_after(asked_ns, left_s)
            color = _decoded(seen) if seen is not None else None
            if seen is not None and color is not None:
                return _frame(seen, color)
            if seen is not None:
                reader.refuse(seen, "a picture that does not decode to the camera's size")
        if not reader.is_alive():
            raise DeviceLost("The camera is not read any more: that ended by a defect, or a close.", _RESTART)
        why = f" ({reader.trouble})" if reader.trouble else ""
        raise StaleFrame(f"The camera gave no new picture for {patience_s:.1f} s{why}.", _ADVICE)

    def close(self) -> None:
        """End the reading thread and the session; idempotent."""
        reader, self._reader = self._reader, None
        if reader is not None:
            reader.end()

    def readings(self) -> dict[str, float]:
        """Return temperatures, frame rate, counts, and the error of the camera's clock."""
        reader = self._reader
        return {} if reader is None else reader.readings()

    def _open(self) -> Session:
        return self._open_session(self._settings)


def _frame(seen: Seen, color: np.ndarray) -> Frame:
    return Frame(
        stamp_ns=seen.stamp_ns,
        color=color,
        depth_m=depth_m(seen.pair),
        color_camera=seen.session.color_camera,
        depth_camera=seen.session.depth_camera,
        color_from_depth=seen.session.color_from_depth,
    )


def depth_m(pair: Pair) -> np.ndarray:
    """Return the pair's depth (576, 640) float32 [m]; NaN where the camera measured nothing."""
    metres = pair.depth_mm.astype(np.float32) * np.float32(pair.scale_mm / 1000.0)
    metres[(pair.depth_mm == 0) | (pair.depth_mm == _FULL_SCALE)] = np.nan
    return metres


def _decoded(seen: Seen) -> np.ndarray | None:
    """Return (720, 1280, 3) RGB; None when the picture does not decode to the calibrated size."""
    lens = seen.session.color_camera
    try:
        color = cv2.imdecode(np.frombuffer(seen.pair.jpeg, np.uint8), cv2.IMREAD_COLOR_RGB)
    except cv2.error:  # the header names a size beyond OpenCV's limit
        return None
    return None if color is None or color.shape != (lens.height, lens.width, 3) else np.asarray(color)


def open_devices(station: Station) -> Devices:
    """Make the devices of driver ``femto_mega``; entry point of the driver registry."""
    return Devices(camera=FemtoMega(station.femto_mega))
