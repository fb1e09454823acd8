"""The picture of now, taken when somebody asks for it while nothing moves."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from bus.errors import BadPayload, Refused
from bus.messages import LivePicture, Observation, PictureRequest
from bus.messages.live_picture import PictureType
from cell.daemon.noted_png import with_region
from cell.daemon.pointed import Pointed
from cell.pick.capture import capture
from cell.pick.equipment import Equipment
from perception.geometry.depth import undistorted
from planning.robot import Robot

AGAIN_S = 0.4
"""Whoever asks sooner is given the same picture: askers do not keep the camera busy."""
_SAME_POSE_RAD = 5e-3
_FILES: dict[PictureType, tuple[str, list[int]]] = {
    "image/png": (".png", []),
    "image/jpeg": (".jpg", [cv2.IMWRITE_JPEG_QUALITY, 80]),
}


class _Taken(NamedTuple):
    """A picture of now. ``counts``: one may point into it."""

    seen: Observation
    counts: bool
    things_ns: int
    gone: tuple[int, ...]


class LivePictures:
    """Takes pictures of a cell in which nothing moves. Its members are for one thread.

    Args:
        is_at_rest: no cycle is open or about to begin, and nothing moves.
        is_held: the cell is held: nothing moves, and a person may look, but point at nothing.
        pointed: is told of each picture, so that somebody may point into it.
        now_s: a monotonic clock.
    """

    def __init__(
        self,
        equipment: Equipment,
        is_at_rest: Callable[[], bool],
        is_held: Callable[[], bool],
        pointed: Pointed,
        now_s: Callable[[], float],
    ) -> None:
        self._e, self._is_at_rest, self._is_held = equipment, is_at_rest, is_held
        self._pointed, self._now_s = pointed, now_s
        self._robot = Robot(equipment.station)  # of its own: the equipment's is for the thread of the cycle
        self._last: _Taken | None = None
        self._taken_s = 0.0

    def now(self, request: PictureRequest) -> LivePicture:
        """Return the picture.

        Raises:
            Refused: NOT_AT_REST; PICTURE_ELSEWHERE: the arm rests elsewhere, and only one from there is wanted.
            StaleFrame: and the errors of camera and arm.
        """
        self._require_rest(or_held=not request.from_capture_pose)
        if self._last is None or self._now_s() - self._taken_s > AGAIN_S:
            self._last = self._taken()
            self._taken_s = self._now_s()
            self._require_rest(or_held=not request.from_capture_pose)  # still: something may have begun meanwhile
        seen, counts, things_ns, gone = self._last
        if request.from_capture_pose and not counts:
            raise Refused(
                "The arm rests, but not where the cell looks for things from.",
                "Reset the cell: it goes there.",
                code="PICTURE_ELSEWHERE",
            )
        data = encoded(undistorted(seen.frame), request.media_type)
        return LivePicture(
            stamp_ns=seen.frame.stamp_ns,
            data=with_region(data, seen, self._e.station) if request.media_type == "image/png" else data,
            media_type=request.media_type,
            from_capture_pose=counts,
            things_ns=things_ns,
            gone=gone,
        )

    def _require_rest(self, *, or_held: bool) -> None:
        if not (self._is_at_rest() or (or_held and self._is_held())):
            raise Refused(
                "The cell works: it shows what it has found, and no picture of now.",
                "Wait until it rests; what a cycle saw is published on view/color.",
                code="NOT_AT_REST",
            )

    def _taken(self) -> _Taken:
        seen = capture(self._e.camera, self._e.arm, self._robot)
        counts = self._is_at_rest() and self._is_from_capture_pose(seen)
        return _Taken(seen, counts, *self._pointed.show_live(seen.frame.stamp_ns, is_from_capture_pose=counts))

    def _is_from_capture_pose(self, seen: Observation) -> bool:
        off_rad = np.abs(seen.view.q_rad - np.asarray(self._e.station.arm.capture_q_rad)).max()
        return bool(off_rad < _SAME_POSE_RAD)


def encoded(color: npt.NDArray[np.uint8], media_type: PictureType) -> bytes:
    """Return an image (H, W, 3) as a file. Raises: BadPayload for one that has no such file."""
    ending, settings = _FILES[media_type]
    ok, data = cv2.imencode(ending, color[..., ::-1], settings)
    if not ok:
        raise BadPayload(f"No {media_type} can be made of an image of shape {color.shape}.")
    return data.tobytes()
