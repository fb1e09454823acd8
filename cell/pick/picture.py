"""The picture that a client chooses a pixel from: what the camera sees now, from the capture pose."""

from __future__ import annotations

import cv2

from bus.errors import BadPayload, Refused
from bus.messages import Frame, Picture
from cell.machine.states import State
from drivers.interface import Camera
from perception.geometry.depth import undistorted

AT_THE_CAPTURE_POSE = (State.IDLE, State.COMPLETE)
"""States in which the arm rests where it looks from."""


def picture_now(camera: Camera, state: State) -> Picture:
    """The picture, newly taken. Raises: Refused (NO_PICTURE) in another state; the errors of the camera."""
    if state not in AT_THE_CAPTURE_POSE:
        raise Refused(
            f"The arm does not rest at its capture pose: the cell is {state}.",
            f"Ask while it is {' or '.join(AT_THE_CAPTURE_POSE)}; what a cycle saw is published on view/color.",
            code="NO_PICTURE",
            state=state,
        )
    return as_picture(camera.capture())


def as_picture(frame: Frame) -> Picture:
    """The undistorted colour image of a frame. Raises: BadPayload when it cannot be encoded."""
    color = undistorted(frame)
    ok, png = cv2.imencode(".png", color[..., ::-1])
    if not ok:
        raise BadPayload(f"Cannot encode a colour image of shape {color.shape}.")
    return Picture(stamp_ns=frame.stamp_ns, width_px=color.shape[1], height_px=color.shape[0], png=png.tobytes())
