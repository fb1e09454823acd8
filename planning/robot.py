"""The arm, its hand and camera, and what stands around them: forward kinematics, forces and collisions.

Model: franka_description's FR3 with the Franka Hand (the ``franky_sim`` wheel's URDF and collision meshes).
"""

from __future__ import annotations

import re
from importlib.resources import files
from itertools import combinations, product
from pathlib import Path

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from bus.arrays import Joints, Transform, Vector3
from config.scene import scene_boxes
from config.schema import CameraSettings, Station

Array = npt.NDArray[np.float64]

HAND_FROM_TCP_M = 0.1034
"""From the hand's origin to the tcp, along the approach axis (Franka Hand manual; URDF frame ``fr3_hand_tcp``)."""
FINGER_TIP_M = 0.0095
"""How far the finger tips reach beyond the tcp (URDF: 0.0584 + 0.0545 - 0.1034 m)."""
FINGER_TIP_SIZE_M = (0.0175, 0.0152)
"""Finger tip across and along the closing axis, outward from the pad (URDF)."""
FINGER_CLEARANCE_M = 0.002
"""How near the fingers may come to the table and the tray: they work where objects lie."""
CAMERA_SIZE_M = (0.095, 0.030, 0.032)
"""Housing of the wrist camera in its colour frame; its front is 5 mm before the frame's origin."""

# Neighbours that always overlap, or cannot reach each other (tests/planning/test_robot.py measures both).
_NEIGHBOURS = {
    frozenset(pair)
    for pair in (
        *((f"link {i}", f"link {i + 1}") for i in range(7)),
        ("link 5", "link 7"),
        ("link 7", "hand"),
        ("link 7", "camera"),
        ("hand", "camera"),
        *((finger, other) for finger in ("left finger", "right finger") for other in ("hand", "camera", "link 7")),
        ("left finger", "right finger"),
    )
}


class Robot:
    """The FR3 of one station. Not thread-safe: collision queries share their working memory.

    Args:
        station: camera pose, scene boxes and clearance are read from it.
    """

    def __init__(self, station: Station) -> None:
        self.station = station
        assets = Path(str(files("franky_sim"))) / "assets"
        urdf = str(assets / "fr3.urdf")
        self._model = pin.buildModelFromUrdf(urdf)
        self._data = self._model.createData()
        self._hand = self._model.getFrameId("fr3_hand")
        self._flange = self._model.getFrameId("fr3_link8")
        self._tcp = self._model.getFrameId("fr3_hand_tcp")
        self._max_width_m = station.hand.max_width_m
        self._hand_from_color = hand_from_color(station.camera)
        self._geometry = pin.buildGeomFromUrdf(self._model, urdf, pin.GeometryType.COLLISION, package_dirs=str(assets))
        self._add_camera()
        scene = self._add_scene(station)
        self._add_pairs(scene)
        self._geometry_data = self._geometry.createData()
        self._set_margins(scene, station.planning.clearance_m)
        self._manager = pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(
            self._model, self._geometry, self._geometry_data
        )

    # --- kinematics -------------------------------------------------------------------------------------------------

    def base_from_flange(self, q_rad: Joints) -> Transform:
        """Pose (4, 4) of the flange (URDF ``fr3_link8``)."""
        return self._frame(q_rad, self._flange)

    def base_from_hand(self, q_rad: Joints) -> Transform:
        """Pose (4, 4) of the hand; z = approach, y = closing axis."""
        return self._frame(q_rad, self._hand)

    def base_from_tcp(self, q_rad: Joints) -> Transform:
        """Pose (4, 4) of the tcp, between the finger pads."""
        return self._frame(q_rad, self._tcp)

    def base_from_color(self, q_rad: Joints) -> Transform:
        """Pose of the wrist camera's colour (optical) frame."""
        return np.asarray(self.base_from_hand(q_rad) @ self._hand_from_color)

    def jacobian(self, q_rad: Joints) -> Array:
        """(6, 7): tcp velocity (linear, then angular) in ``base`` axes, from joint velocities."""
        full = pin.computeFrameJacobian(
            self._model, self._data, self._full(q_rad, 0.0), self._tcp, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        return np.array(full[:, :7])

    def manipulability(self, q_rad: Joints) -> float:
        """Yoshikawa's measure ``sqrt(det(J Jt))``; 0 = singular."""
        jacobian = self.jacobian(q_rad)
        return float(np.sqrt(max(0.0, np.linalg.det(jacobian @ jacobian.T))))

    def tcp_force_n(self, q_rad: Joints, tau_ext_nm: Joints) -> Vector3:
        """The force (3,) in ``base`` that acts on the tcp, from the joint torques it causes (least squares)."""
        wrench, *_ = np.linalg.lstsq(self.jacobian(q_rad).T, np.asarray(tau_ext_nm), rcond=None)
        return np.asarray(wrench[:3])

    # --- collision --------------------------------------------------------------------------------------------------

    def collision(self, q_rad: Joints, *, width_m: float | None = None) -> str | None:
        """What comes nearer than the clearance, e.g. ``right finger touches table``; None if nothing does.

        Args:
            width_m: opening of the hand; None = fully open.
        """
        full = self._full(q_rad, self._max_width_m if width_m is None else width_m)
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._geometry_data, full)
        self._manager.update(False)
        callback = pin.CollisionCallBackDefault(self._geometry, self._geometry_data, True)
        self._manager.collide(callback)
        if not callback.collision:
            return None
        pair = self._geometry.collisionPairs[callback.collisionPairIndex]
        return f"{self._part(pair.first)} touches {self._part(pair.second)}"

    def self_collision_pairs(self) -> tuple[tuple[str, str], ...]:
        """The checked pairs of the robot's own parts, in people's words."""
        pairs = [
            (self._part(p.first), self._part(p.second))
            for p in self._geometry.collisionPairs
            if not self._geometry.geometryObjects[p.second].name.startswith("scene ")
        ]
        return tuple(dict.fromkeys(pairs))

    # --- construction -----------------------------------------------------------------------------------------------

    def _frame(self, q_rad: Joints, frame: int) -> Transform:
        pin.forwardKinematics(self._model, self._data, self._full(q_rad, 0.0))
        return np.array(pin.updateFramePlacement(self._model, self._data, frame).homogeneous)

    def _full(self, q_rad: Joints, width_m: float) -> Array:
        return np.concatenate([q_rad, [width_m / 2, width_m / 2]])

    def _part(self, index: int) -> str:
        return part_name(self._geometry.geometryObjects[index].name)

    def _add(self, name: str, frame: int, frame_from_box: pin.SE3, size_m: tuple[float, float, float]) -> int:
        parent = self._model.frames[frame]
        placement = parent.placement * frame_from_box
        box = pin.GeometryObject(name, parent.parentJoint, frame, placement, coal.Box(*size_m))
        return int(self._geometry.addGeometryObject(box))

    def _add_camera(self) -> None:
        color_from_box = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.005 - CAMERA_SIZE_M[2] / 2]))
        self._add("fr3_camera_0", self._hand, pin.SE3(self._hand_from_color) * color_from_box, CAMERA_SIZE_M)

    def _add_scene(self, station: Station) -> tuple[int, ...]:
        return tuple(
            self._add(f"scene {box.name}", 0, pin.SE3(np.eye(3), np.array(box.center_m)), box.size_m)
            for box in scene_boxes(station.scene)
        )

    def _add_pairs(self, scene: tuple[int, ...]) -> None:
        robot = [i for i in range(self._geometry.ngeoms) if i not in scene]
        for a, b in combinations(robot, 2):
            names = frozenset((self._part(a), self._part(b)))
            if len(names) == 2 and names not in _NEIGHBOURS:
                self._geometry.addCollisionPair(pin.CollisionPair(a, b))
        for a, b in product(robot, scene):
            if not (self._part(a) == "link 0" and b == scene[0]):  # the base stands on the table
                self._geometry.addCollisionPair(pin.CollisionPair(a, b))

    def _set_margins(self, scene: tuple[int, ...], clearance_m: float) -> None:
        requests = self._geometry_data.collisionRequests
        for index, pair in enumerate(self._geometry.collisionPairs):
            near_work = pair.second in scene and "finger" in self._part(pair.first)
            requests[index].security_margin = min(clearance_m, FINGER_CLEARANCE_M) if near_work else clearance_m


def hand_from_color(camera: CameraSettings) -> Transform:
    """Pose of the colour camera in the hand frame."""
    w, x, y, z = camera.hand_from_color_wxyz
    rotation = pin.Quaternion(w, x, y, z).normalized().toRotationMatrix()
    return np.array(pin.SE3(rotation, np.array(camera.hand_from_color_position_m)).homogeneous)


def part_name(geometry: str) -> str:
    """``fr3_rightfinger_2`` -> ``right finger``, ``fr3_link4_0`` -> ``link 4``, ``scene table`` -> ``table``."""
    if geometry.startswith("scene "):
        return geometry.removeprefix("scene ")
    stem = re.sub(r"^fr3_|_\d+$", "", geometry)
    return re.sub(r"(link)(\d)", r"\1 \2", re.sub(r"(left|right)(finger)", r"\1 \2", stem))
