"""Stage 1, capture: one frame, and the camera pose at its exposure. Frames: docs/frames.md."""

from __future__ import annotations

import numpy as np

from bus.errors import DeviceLost, StaleFrame
from bus.messages import Frame, Observation, View
from drivers.interface import Arm, Camera
from planning.robot import Robot

_REST_RAD = 2e-3
_MIN_SEEN = 0.05
"""Least share of valid depth pixels; every scene of a pick has more."""


def capture(camera: Camera, arm: Arm, robot: Robot, newer_than_ns: int = 0) -> Observation:
    """A frame and the pose of the colour camera in ``base`` at its exposure.

    Args:
        newer_than_ns: least stamp of the frame, UTC.

    Raises:
        StaleFrame: the arm moved during the exposure (the pose would be wrong), or the frame is too old.
        DeviceLost: the arm's position is not finite. Also the other errors of the devices.
    """
    before = arm.state()
    frame = camera.capture()
    after = arm.state()
    if frame.stamp_ns <= newer_than_ns:
        late_s = (newer_than_ns - frame.stamp_ns) / 1e9
        raise StaleFrame(f"The camera shows an old frame: {late_s:.1f} s before the oldest that would do.")
    moved_rad = float(np.abs(after.q_rad - before.q_rad).max())
    if not np.isfinite(moved_rad):
        raise DeviceLost("The arm reports a position that is not a finite number.", "Restart its node.")
    if moved_rad > _REST_RAD:
        raise StaleFrame(f"The arm moved by {moved_rad:.4f} rad during the exposure.", "Capture while it rests.")
    view = View(stamp_ns=frame.stamp_ns, arm=after, base_from_color=robot.base_from_color(after.q_rad))
    return Observation(view=view, frame=frame)


def require_sight(frame: Frame) -> None:
    """Raises: DeviceLost when the depth camera measures nothing, which is different from an empty table."""
    seen = float((frame.depth_m > 0).mean())  # NaN compares false
    if seen < _MIN_SEEN:
        raise DeviceLost(f"The camera is blind: it measured {seen:.1%} of its depth pixels.", "Is its lens covered?")
