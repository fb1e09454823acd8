"""The arm with its hand and wrist camera: forward kinematics, forces, and the shapes of its parts (docs/frames.md).

Model: franka_description's FR3 with the Franka Hand (the ``franky_sim`` wheel's URDF and collision meshes), or the
arm of ``[robot]`` with that hand.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cached_property
from itertools import product

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from bus.arrays import Joints, Transform, Vector3
from bus.transforms import from_translation, from_wxyz
from config.devices import CameraSettings
from config.franka_hand import HAND_FROM_TCP_M
from config.robot import limits_of
from config.schema import Station
from planning.arm import Arm
from planning.description import ASSETS, describe
from planning.kinematics import FR3_ARM
from planning.serial_arm import SerialArm

Array = npt.NDArray[np.float64]

HAND_FROM_TCP = from_translation((0.0, 0.0, HAND_FROM_TCP_M))
CAMERA_SIZE_M = (0.095, 0.030, 0.032)
"""Housing of the wrist camera in its colour frame; its front is 5 mm before the frame's origin."""
_TCP_FROM_FLANGE = np.array(
    [[0.5**0.5, -(0.5**0.5), 0, 0], [0.5**0.5, 0.5**0.5, 0, 0], [0, 0, 1, -HAND_FROM_TCP_M], [0, 0, 0, 1]]
)
"""The hand is mounted turned by -45 degrees."""


class Robot:
    """The robot of one station. Not thread-safe: its methods share working memory.

    Args:
        station: gives the arm, the camera's pose and the hand's width.

    Attributes:
        model: of Pinocchio, with the arm's joints and two finger joints.
        description: its URDF, and names in it. ``arm``: its inverse kinematics.

    Raises:
        ConfigError: the arm's URDF cannot be used.
    """

    def __init__(self, station: Station) -> None:
        self.station = station
        self.description = describe(station)
        urdf = self.description.urdf
        self.model = pin.buildModelFromXML(urdf)
        self._data = self.model.createData()
        self.hand_frame = int(self.model.getFrameId("fr3_hand"))
        self._flange = self.model.getFrameId(self.description.flange)
        self._tcp = self.model.getFrameId("fr3_hand_tcp")
        limits = limits_of(station)
        self.arm: Arm = FR3_ARM if station.robot is None else SerialArm(self.model, self._flange, limits)
        self._fingers = (limits.joints + 1, limits.joints + 2)
        self._hand_from_color = hand_from_color(station.camera)
        self._meshes = pin.buildGeomFromUrdfString(
            self.model, urdf, pin.GeometryType.COLLISION, package_dirs=str(ASSETS)
        )

    @property
    def last_link(self) -> str:
        """The readable name of the link that carries the hand."""
        return part_name(self.description.links[-1])

    # --- kinematics -------------------------------------------------------------------------------------------------

    def base_from_flange(self, q_rad: Joints) -> Transform:
        """Return the pose (4, 4) [m] of the flange (of the FR3 ``fr3_link8``)."""
        return self._frame(q_rad, self._flange)

    def base_from_hand(self, q_rad: Joints) -> Transform:
        """Return the pose (4, 4) [m] of the hand; z = approach, y = closing axis."""
        return self._frame(q_rad, self.hand_frame)

    def base_from_tcp(self, q_rad: Joints) -> Transform:
        """Return the pose (4, 4) [m] of the tcp, between the finger pads."""
        return self._frame(q_rad, self._tcp)

    def base_from_color(self, q_rad: Joints) -> Transform:
        """Return the pose (4, 4) [m] of the wrist camera's colour (optical) frame."""
        return np.asarray(self.base_from_hand(q_rad) @ self._hand_from_color)

    def jacobian(self, q_rad: Joints) -> Array:
        """Return the Jacobian (6, n): joint velocities to tcp velocity (linear, then angular) in ``base`` axes."""
        full = pin.computeFrameJacobian(
            self.model, self._data, self._with_fingers(q_rad), self._tcp, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        return np.array(full[:, : self.arm.limits.joints])

    def tcp_force_n(self, q_rad: Joints, tau_ext_nm: Joints) -> Vector3:
        """Return the force (3,) [N] in ``base`` on the tcp that explains external joint torques (n,), least squares."""
        wrench, *_ = np.linalg.lstsq(self.jacobian(q_rad).T, np.asarray(tau_ext_nm), rcond=None)
        return np.asarray(wrench[:3])

    def _with_fingers(self, q_rad: Joints) -> Array:
        return np.concatenate([q_rad, np.zeros(2)])

    def _frame(self, q_rad: Joints, frame: int) -> Transform:
        pin.forwardKinematics(self.model, self._data, self._with_fingers(q_rad))
        return np.array(pin.updateFramePlacement(self.model, self._data, frame).homogeneous)

    # --- shapes -----------------------------------------------------------------------------------------------------

    @cached_property
    def meshes(self) -> tuple[pin.GeometryObject, ...]:
        """Collision meshes of every part, and the camera's housing."""
        return (*self._meshes.geometryObjects, self._camera())

    @cached_property
    def hulls(self) -> tuple[pin.GeometryObject, ...]:
        """The same parts as convex hulls: they contain the meshes, and distances to them are faster to check."""
        hulls = []
        for part in self.meshes:
            hull = part.copy()
            if isinstance(part.geometry, coal.BVHModelBase):
                part.geometry.buildConvexHull(True, "Qt")
                hull.geometry = part.geometry.convex
            hulls.append(hull)
        return tuple(hulls)

    @cached_property
    def meshes_at_any_width(self) -> tuple[pin.GeometryObject, ...]:
        """The meshes, each of a finger grown to what it fills from closed to fully open; the finger joints are 0."""
        return self._at_any_width(self.meshes)

    @cached_property
    def hulls_at_any_width(self) -> tuple[pin.GeometryObject, ...]:
        """The convex hulls, each of a finger grown to what it fills from closed to fully open; its joint is 0."""
        return self._at_any_width(self.hulls)

    def _at_any_width(self, parts: Sequence[pin.GeometryObject]) -> tuple[pin.GeometryObject, ...]:
        slid_m = np.array([0.0, self.station.hand.max_width_m / 2, 0.0])  # along the finger joint's y
        return tuple(_slid(part, slid_m) if part.parentJoint in self._fingers else part for part in parts)

    def on_hand(self, name: str, shape: coal.CollisionGeometry, hand_from_shape: Transform) -> pin.GeometryObject:
        """Return a shape that moves with the hand, at ``hand_from_shape`` (4, 4)."""
        frame = self.model.frames[self.hand_frame]
        placement = frame.placement * pin.SE3(hand_from_shape)
        return pin.GeometryObject(name, frame.parentJoint, self.hand_frame, placement, shape)

    def _camera(self) -> pin.GeometryObject:
        color_from_box = from_translation((0.0, 0.0, 0.005 - CAMERA_SIZE_M[2] / 2))
        return self.on_hand("fr3_camera_0", coal.Box(*CAMERA_SIZE_M), self._hand_from_color @ color_from_box)


def _slid(part: pin.GeometryObject, slid_m: Vector3) -> pin.GeometryObject:
    """The convex hull of a box at its place and at its place moved by ``slid_m``, in the frame of its joint."""
    assert isinstance(part.geometry, coal.Box), "the URDF's fingers are boxes"
    corners = np.array(list(product((-1.0, 1.0), repeat=3))) * part.geometry.halfSide
    here = corners @ part.placement.rotation.T + part.placement.translation
    hull = convex_hull(np.concatenate([here, here + slid_m]))
    return pin.GeometryObject(part.name, part.parentJoint, part.parentFrame, pin.SE3.Identity(), hull)


def convex_hull(points: npt.NDArray[np.float64]) -> coal.CollisionGeometry:
    """Return the convex hull of points (n, 3)."""
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(0, 0)
    mesh.addVertices(points)
    mesh.endModel()
    mesh.buildConvexHull(False, "Qt")
    return mesh.convex


def flange_pose(base_from_tcp: Array) -> Array:
    """Return the flange poses (..., 4, 4) that bring the tcp to ``base_from_tcp`` (..., 4, 4)."""
    return np.asarray(base_from_tcp @ _TCP_FROM_FLANGE)


def hand_from_color(camera: CameraSettings) -> Transform:
    """Return the pose (4, 4) [m] of the colour camera in the hand frame."""
    return from_wxyz(camera.hand_from_color_wxyz, camera.hand_from_color_position_m)


def part_name(geometry: str) -> str:
    """Return the readable name of a part: ``fr3_rightfinger_2`` -> ``right finger``, ``fr3_link4_0`` -> ``link 4``."""
    stem = re.sub(r"^fr3_|_\d+$", "", geometry)
    return re.sub(r"(link)(\d)", r"\1 \2", re.sub(r"(left|right)(finger)", r"\1 \2", stem))
