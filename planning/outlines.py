"""The robot's parts for the eye: simplified convex hulls, and where each is along a path. Frames: docs/frames.md."""

from __future__ import annotations

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin
from scipy.spatial import ConvexHull

from bus.arrays import JointSamples, Points, PoseSamples, Triangles
from bus.messages import Outline
from planning.robot import Robot, part_name

Array = npt.NDArray[np.float64]

_DIRECTIONS = 60
"""A hull is drawn by its farthest points in so many directions."""


class Outlines:
    """Outlines of one robot, and its poses. Not thread-safe, but shares no working memory with the `Robot`.

    Attributes:
        frames: names of the joints that parts move with; the first is ``base``.
        parts: the outlines in these frames.
    """

    def __init__(self, robot: Robot) -> None:
        self._model, self._data = robot.model, robot.model.createData()
        self._tcp = robot.model.getFrameId("fr3_hand_tcp")
        self.frames = ("base", *(str(name) for name in list(robot.model.names)[1:]))
        self.parts = tuple(_outline(part) for part in robot.hulls)

    def along(self, path_rad: JointSamples, width_m: float) -> tuple[PoseSamples, Points]:
        """Return the poses of all frames (n, f, 3, 4), and the positions of the tcp (n, 3) [m], in ``base``.

        Args:
            path_rad: (n, joints) of the arm.
            width_m: distance between the finger pads.
        """
        poses = np.empty((len(path_rad), len(self.frames), 3, 4), dtype=np.float32)
        tcp_m = np.empty((len(path_rad), 3), dtype=np.float32)
        for row, q_rad in enumerate(path_rad):
            pin.forwardKinematics(self._model, self._data, np.concatenate([q_rad, [width_m / 2, width_m / 2]]))
            poses[row] = [pose.homogeneous[:3] for pose in self._data.oMi]
            tcp_m[row] = pin.updateFramePlacement(self._model, self._data, self._tcp).translation
        return poses, tcp_m


def _outline(part: pin.GeometryObject) -> Outline:
    points = _points(part.geometry) @ part.placement.rotation.T + part.placement.translation
    vertices, faces = simplified(points)
    return Outline(name=part_name(part.name), frame=int(part.parentJoint), vertices_m=vertices, faces=faces)


def _points(shape: coal.CollisionGeometry) -> Array:
    if isinstance(shape, coal.Box):
        signs = np.stack(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0]), axis=-1).reshape(-1, 3)
        return np.asarray(signs * np.asarray(shape.halfSide))
    return np.asarray(shape.points()).reshape(-1, 3)


def simplified(points: Array) -> tuple[Points, Triangles]:
    """Return the vertices (v, 3) of a coarser convex hull of points (n, 3), and its triangles (t, 3), outwards."""
    spread = points[np.unique((_evenly_spread(_DIRECTIONS) @ points.T).argmax(axis=1))]
    hull = ConvexHull(spread if len(spread) > 3 else points, qhull_options="QJ Pp")
    vertices = hull.points
    faces = hull.simplices.copy()
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    inwards = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(axis=1) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    return vertices.astype(np.float32), faces.astype(np.uint16)


def _evenly_spread(count: int) -> Array:
    """Return unit vectors (n, 3), evenly spread over the sphere (Fibonacci's spiral), axes and diagonals too."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    level = np.sqrt(1 - z**2)
    spiral = np.stack([level * np.cos(turn), level * np.sin(turn), z], axis=1)
    corners = np.stack(np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]), axis=-1).reshape(-1, 3)
    return np.concatenate([spiral, corners[np.abs(corners).sum(axis=1) > 0]])
