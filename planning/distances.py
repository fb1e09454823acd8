"""Distances of the robot's convex hulls from the known boxes, along a path. Frames: docs/frames.md."""

from __future__ import annotations

from itertools import product

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from bus.arrays import JointSamples
from config.scene import scene_boxes
from planning.robot import Robot, part_name

Array = npt.NDArray[np.float64]

_STANDS_ON = ("link 0", "table")


def distances(robot: Robot, path_rad: JointSamples, width_m: float) -> tuple[list[tuple[str, str]], Array]:
    """Return (part, box) of every pair, and their distances (n, pairs) [m] along a path; negative = overlap."""
    parts, boxes = robot.hulls, scene_boxes(robot.station.scene)
    solids = [(box.name, coal.Box(*box.size_m), coal.Transform3s(np.eye(3), np.array(box.center_m))) for box in boxes]
    pairs = [(part, solid) for part, solid in product(parts, solids) if (part_name(part.name), solid[0]) != _STANDS_ON]
    data = robot.model.createData()
    found = np.empty((len(path_rad), len(pairs)))
    request = coal.DistanceRequest()
    for row, q_rad in enumerate(path_rad):
        pin.forwardKinematics(robot.model, data, np.concatenate([q_rad, [width_m / 2, width_m / 2]]))
        for column, (part, (_, box, at)) in enumerate(pairs):
            pose = data.oMi[part.parentJoint] * part.placement
            placed = coal.Transform3s(pose.rotation, pose.translation)
            found[row, column] = coal.distance(part.geometry, placed, box, at, request, coal.DistanceResult())
    return [(part_name(part.name), solid[0]) for part, solid in pairs], found
