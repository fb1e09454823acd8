"""Stage 1, capture: one frame, and the pose it was taken from."""

from __future__ import annotations

import numpy as np

from bus.errors import StaleFrame
from bus.messages import Observation, View
from drivers.interface import Arm, Camera
from planning.robot import Robot

_REST_RAD = 2e-3


def capture(camera: Camera, arm: Arm, robot: Robot) -> Observation:
    """A frame and the pose of the colour camera in ``base`` when it was exposed.

    Raises: StaleFrame when the arm moved meanwhile (the pose would be wrong), and whatever the devices raise.
    """
    before = arm.state()
    frame = camera.capture()
    after = arm.state()
    moved_rad = float(np.abs(after.q_rad - before.q_rad).max())
    if moved_rad > _REST_RAD:
        raise StaleFrame(f"The arm moved by {moved_rad:.4f} rad during the exposure.", "Capture while it rests.")
    view = View(stamp_ns=frame.stamp_ns, arm=after, base_from_color=robot.base_from_color(after.q_rad))
    return Observation(view=view, frame=frame)
