"""Bounds how far the robot's points move along joint lines: checks for collision need be no denser than that."""

from __future__ import annotations

from functools import lru_cache
from itertools import product

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from bus.arrays import Joints, JointSamples
from planning.robot import Robot
from planning.world import Thing

Array = npt.NDArray[np.float64]

_FR3_LEVER_M = np.array([1.15, 1.15, 0.95, 0.85, 0.45, 0.40, 0.20])
"""Largest distance of any point of arm, hand or camera from each joint's axis."""
_KNOT_RAD = 0.2
"""Joints turn by so much in all between two poses that are computed."""


def sweep_m(robot: Robot, path_rad: JointSamples) -> Array:
    """Return an upper bound (m,) of how far any point of the robot has moved along the polyline ``path_rad`` (m, n)."""
    return np.concatenate([[0.0], np.cumsum(np.abs(np.diff(path_rad, axis=0)) @ lever_m(robot))])


@lru_cache(maxsize=4)
def lever_m(robot: Robot) -> Array:
    """Return an upper bound (n,) of the distance of any point of arm, hand or camera from each joint's axis."""
    if robot.station.robot is None:
        return _FR3_LEVER_M
    reach_m, found = 0.0, []
    corners, count = _boxes(robot), robot.arm.limits.joints
    for joint in range(count - 1, -1, -1):
        own_m = float(np.linalg.norm(corners[joint][:3], axis=0).max())
        reach_m = max(own_m, reach_m)
        found.append(reach_m)
        reach_m += float(np.linalg.norm(robot.model.jointPlacements[joint + 1].translation))
    return np.array(found[::-1])


class Travel:
    """Bounds the movement more tightly than `sweep_m`, by a factor of about 2, from poses along the line.

    Args:
        held: an object in the hand, which moves with it.
    """

    def __init__(self, robot: Robot, held: Thing | None) -> None:
        self._count = robot.arm.limits.joints
        self._fixed = np.stack([robot.model.jointPlacements[joint].homogeneous for joint in range(1, self._count + 1)])
        self._corners = _boxes(robot)
        self._lever_m = lever_m(robot)
        if held is not None:
            corners = robot.on_hand(held.name, held.shape, held.pose).placement.homogeneous @ _corners(held.shape)
            self._corners = self._corners.copy()
            self._corners[-1] = _around(np.concatenate([self._corners[-1], corners], axis=1))
            self._lever_m = lever_m(robot) + float(np.linalg.norm(corners[:3], axis=0).max())

    def along(self, q_from_rad: Joints, q_to_rad: Joints) -> Array:
        """Return how far any point has moved at most (n,) [m] after evenly spaced shares of the line, from 0 on.

        The distance of two points on different parts has not changed by more, either. Between two of the shares the
        bound grows linearly.
        """
        turn_rad = np.abs(q_to_rad - q_from_rad)
        steps = max(1, int(np.ceil(turn_rad.sum() / _KNOT_RAD)))
        points = self._points(np.linspace(q_from_rad, q_to_rad, steps + 1))
        chord_m = np.sqrt(np.square(np.diff(points, axis=0)).sum(axis=2).max(axis=2))
        # A point's second derivative along joints j <= k is at most its distance from axis k. Its speed is its mean
        # speed between two poses, up to half a step of that.
        bend_m = np.cumsum(np.diff(np.cumsum(turn_rad) ** 2, prepend=0.0) * self._lever_m) / (2 * steps**2)
        return np.concatenate([[0.0], np.cumsum(_largest(chord_m + bend_m, turn_rad * self._lever_m / steps))])

    def _points(self, q_rad: JointSamples) -> Array:
        """Return the corners (m, n, 3, 8) of the boxes around what each joint moves."""
        cos, sin = np.cos(q_rad)[..., None], np.sin(q_rad)[..., None]
        turned = np.empty((*q_rad.shape, 4, 4))
        turned[..., 0] = self._fixed[:, :, 0] * cos + self._fixed[:, :, 1] * sin
        turned[..., 1] = self._fixed[:, :, 1] * cos - self._fixed[:, :, 0] * sin
        turned[..., 2:] = self._fixed[:, :, 2:]
        for joint in range(1, self._count):
            turned[:, joint] = turned[:, joint - 1] @ turned[:, joint]
        return np.asarray((turned @ self._corners)[:, :, :3])


def _largest(moved_m: Array, swept_m: Array) -> Array:
    """Return the largest movement (n,) of any part, or change of the distance of two parts.

    Two parts come nearer by no more than both move, and by no more than the joints between them sweep.

    Args:
        moved_m: (n, joints) of what each joint carries, up to the next one.
        swept_m: (joints,) by each joint alone, at most.
    """
    beyond_m = np.maximum.accumulate(moved_m[:, ::-1], axis=1)[:, ::-1]
    by_joints_m = np.cumsum(swept_m[::-1])[::-1]
    nearer_m = np.minimum(moved_m[:, :-1] + beyond_m[:, 1:], by_joints_m[1:])
    return np.asarray(np.maximum(beyond_m[:, 0], nearer_m.max(axis=1)))


@lru_cache(maxsize=4)
def _boxes(robot: Robot) -> Array:
    """Return the corners (n, 4, 8) of a box around everything that moves with each joint, in the joint's frame."""
    count = robot.arm.limits.joints
    points: dict[int, list[Array]] = {joint: [] for joint in range(1, count + 1)}
    for opening_m in (0.0, robot.station.hand.max_width_m):
        data = robot.model.createData()
        pin.forwardKinematics(robot.model, data, np.array([*np.zeros(count), opening_m / 2, opening_m / 2]))
        for part in robot.hulls:
            joint = min(part.parentJoint, count)  # the fingers are on the hand
            if joint > 0:
                placement = data.oMi[joint].inverse() * data.oMi[part.parentJoint] * part.placement
                points[joint].append(placement.homogeneous @ _corners(part.geometry))
    return np.stack([_around(np.concatenate(points[joint], axis=1)) for joint in range(1, count + 1)])


def _corners(shape: coal.CollisionGeometry) -> Array:
    """Return the corners (4, 8) of the box around a shape, as homogeneous coordinates in its frame."""
    shape.computeLocalAABB()
    return _between(shape.aabb_local.min_, shape.aabb_local.max_)


def _around(points: Array) -> Array:
    """Return the corners (4, 8) of the box around points (4, n)."""
    return _between(points[:3].min(axis=1), points[:3].max(axis=1))


def _between(low: Array, high: Array) -> Array:
    return np.array([[*corner, 1.0] for corner in product(*zip(low, high, strict=True))]).T
