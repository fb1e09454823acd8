"""The picture of now, taken when somebody asks for it while the cell rests."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from bus.errors import BadPayload, Refused
from bus.messages import LivePicture
from cell.daemon.pointed import Pointed
from cell.pick.capture import capture
from cell.pick.equipment import Equipment
from perception.geometry.depth import undistorted

AGAIN_S = 0.4
"""Whoever asks sooner is given the same picture: askers do not keep the camera busy."""
_SAME_POSE_RAD = 5e-3
_JPEG_QUALITY = 80


class LivePictures:
    """Takes pictures of a cell that rests. Its members are for one thread.

    Args:
        is_at_rest: no cycle is open or about to begin, and nothing moves.
        pointed: is told of each picture, so that somebody may point into it.
        now_s: a monotonic clock.
    """

    def __init__(
        self, equipment: Equipment, is_at_rest: Callable[[], bool], pointed: Pointed, now_s: Callable[[], float]
    ) -> None:
        self._e, self._is_at_rest, self._pointed, self._now_s = equipment, is_at_rest, pointed, now_s
        self._last: LivePicture | None = None
        self._taken_s = 0.0

    def now(self) -> LivePicture:
        """The picture. Raises: Refused (NOT_AT_REST), StaleFrame, and the errors of camera and arm."""
        if not self._is_at_rest():
            raise Refused(
                "The cell works: it shows what it has found, and no picture of now.",
                "Wait until it rests.",
                code="NOT_AT_REST",
            )
        if self._last is None or self._now_s() - self._taken_s > AGAIN_S:
            self._last = self._taken()
            self._taken_s = self._now_s()
        return self._last

    def _taken(self) -> LivePicture:
        seen = capture(self._e.camera, self._e.arm, self._e.robot)
        color = undistorted(seen.frame)
        is_drawn, jpeg = cv2.imencode(".jpg", color[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        if not is_drawn:
            raise BadPayload(f"No JPEG can be made of an image of shape {color.shape}.")
        off_rad = np.abs(seen.view.arm.q_rad - np.asarray(self._e.station.arm.capture_q_rad)).max()
        stamp_ns, is_there = seen.frame.stamp_ns, bool(off_rad < _SAME_POSE_RAD)
        things_ns, gone = self._pointed.show_live(stamp_ns, is_from_capture_pose=is_there)
        return LivePicture(
            stamp_ns=stamp_ns, jpeg=jpeg.tobytes(), from_capture_pose=is_there, things_ns=things_ns, gone=gone
        )
