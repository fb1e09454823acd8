"""The points of a look that belong to the arm itself: from aside, the wrist camera sees the arm's base."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from bus.arrays import Joints, Points
from planning.robot import Robot

_BESIDE_M = 0.020
"""Points so near to the box around a part are its own: the mounting, and the depth at its rim, are not exact."""

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


def on_robot(robot: Robot, q_rad: Joints, points_base: Points) -> Mask:
    """Return the points (..., 3) [m] in ``base``, NaN = none, on a part of the robot at ``q_rad`` (joints,)."""
    flat = points_base.reshape(-1, 3).astype(float)
    own = np.zeros(len(flat), dtype=bool)
    for base_from_part, low, high in _boxes(robot, q_rad):
        in_part = (flat - base_from_part.translation) @ base_from_part.rotation
        own |= ((in_part > low - _BESIDE_M) & (in_part < high + _BESIDE_M)).all(axis=1)  # NaN compares false
    return own.reshape(points_base.shape[:-1])


def _boxes(robot: Robot, q_rad: Joints) -> list[tuple[pin.SE3, Array, Array]]:
    """Of each part: its pose in ``base``, and the box around it in its own frame; the hand may be open or not."""
    shapes = pin.GeometryModel()
    for part in robot.hulls_at_any_width:
        part.geometry.computeLocalAABB()
        shapes.addGeometryObject(part)
    full_rad = np.concatenate([q_rad, np.zeros(2)])
    placed = shapes.createData()
    pin.updateGeometryPlacements(robot.model, robot.model.createData(), shapes, placed, full_rad)
    boxes = [part.geometry.aabb_local for part in shapes.geometryObjects]
    return [(pose, np.array(box.min_), np.array(box.max_)) for pose, box in zip(placed.oMg, boxes, strict=True)]
