"""The intrinsics of one camera."""

from __future__ import annotations

from bus.frozen import Message


class CameraModel(Message):
    """A pinhole camera with OpenCV's rational distortion (Brown-Conrady K6 on the Femto Mega; docs/frames.md).

    Attributes:
        width, height: image size [px].
        fx, fy, cx, cy: intrinsics [px], pixel centres at integers.
        distortion: (k1, k2, p1, p2, k3, k4, k5, k6), or empty for none.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
