"""Poses of every part of the arm in its parent's frame: the URDF tree, and the camera on the hand (docs/frames.md)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin

from bus.arrays import Joints, Transform
from planning.robot import Robot, hand_from_color

CAMERA = "camera"
"""Frame of the colour camera now; ``color`` is its frame at the capture."""
_HAND_TREE = (
    ("fr3_hand", "fr3_hand_tcp"),
    ("fr3_hand", "fr3_leftfinger"),
    ("fr3_hand", "fr3_rightfinger"),
)


class Links:
    """The links of one robot's model. Not thread-safe, but shares no working memory with the `Robot`."""

    def __init__(self, robot: Robot) -> None:
        self._model, self._data = robot.model, robot.model.createData()
        chain = ("base", *robot.description.links, robot.description.flange, "fr3_hand")
        self._tree = (*pairwise(chain), *_HAND_TREE)
        self._frames = {name: self._model.getFrameId(name) for name in {one for pair in self._tree for one in pair}}
        self._hand_from_camera = hand_from_color(robot.station.camera)

    def at(self, q_rad: Joints, width_m: float) -> dict[tuple[str, str], Transform]:
        """Return {(parent, child): parent_from_child (4, 4) [m]}.

        Args:
            q_rad: (n,) of the arm.
            width_m: distance between the finger pads.
        """
        pin.forwardKinematics(self._model, self._data, np.concatenate([q_rad, [width_m / 2, width_m / 2]]))
        pin.updateFramePlacements(self._model, self._data)
        placed = {name: self._data.oMf[frame] for name, frame in self._frames.items()}
        poses = {(parent, child): placed[parent].actInv(placed[child]).homogeneous for parent, child in self._tree}
        return {**poses, ("fr3_hand", CAMERA): self._hand_from_camera}
