"""Composes the MuJoCo model: arm and Panda hand, the scene's boxes, wrist camera, and the objects (docs/frames.md)."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from config.franka_hand import FINGER_LENGTH_M
from config.scene import Box, scene_boxes
from config.schema import Station
from drivers.sim.board import lay_board
from drivers.sim.objects import add_object
from drivers.sim.robot import robot_spec

FINGER_JOINTS = ("finger_joint1", "finger_joint2")
HAND_ACTUATOR = "hand"
COLOR_CAMERA, DEPTH_CAMERA = "color", "depth"

# Contact of the pads: elliptic cones and a high impedance ratio hold a grasp without creep (measured).
_TIMESTEP_S = 0.001
_IMPRATIO = 10.0
_TORSION_M, _ROLLING_M = 0.01, 1e-4
# The shipped hand actuator (100 N/m) closes too weakly. This servo acts on the mean finger position, and is stiff
# enough that a thin object, too, gets all of the commanded force.
_HAND_STIFFNESS_N_M = 20_000.0
_HAND_DAMPING_NS_M = 400.0
_JAW_ROOT_M = 0.010  # along the finger
_JAW_SOLREF, _JAW_SOLIMP = (0.004, 1.0), (0.97, 0.995, 0.001, 0.5, 2.0)  # rubber on a hard object yields 0.1-0.5 mm
_TOUCHING = ("hand", "left_finger", "right_finger")
_TOUCH_SOLREF, _TOUCH_SOLIMP = (-2500.0, -40.0), (0.95, 0.99, 0.001, 0.5, 2.0)
"""About 50 N/mm for the arm's effective mass: assumed, not measured on a robot."""
_NO_TORSION = (0.005, 1e-4, 1e-4)
_VISIBLE_GROUP, _COLLISION_GROUP = 2, 3
_APART_M = 2.0
_LINK_RGBA = (0.90, 0.92, 0.93, 1.0)
_TABLE_RGBA = (0.46, 0.50, 0.52, 1.0)
_TRAY_RGBA = (0.20, 0.33, 0.42, 1.0)


def compose(
    station: Station, objects: Mapping[str, str], hand_from_camera: dict[str, np.ndarray], fovy_deg: dict[str, float]
) -> mujoco.MjSpec:
    """Compose the whole cell.

    Args:
        objects: name of the free body -> name of its object.
        hand_from_camera: pose (4x4, optical frame) of each rendered camera in the hand.
        fovy_deg: vertical field of view of each rendered camera.
    """
    spec = robot_spec(station)
    spec.option.timestep = _TIMESTEP_S
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = _IMPRATIO
    spec.stat.extent = 1.0
    spec.visual.map.znear, spec.visual.map.zfar = 0.02, 8.0
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 2048, 2048
    spec.visual.quality.offsamples, spec.visual.quality.shadowsize = 0, 1024
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = (0.35,) * 3, (0.25,) * 3
    spec.visual.headlight.specular = (0.0,) * 3
    _prepare_robot(spec, station)
    _furnish(spec, station)
    _soften_touch(spec, station)
    if station.sim.board:
        lay_board(spec, station.calibration)
    for name, pose in hand_from_camera.items():
        _add_camera(spec.body("hand"), name, pose, fovy_deg[name])
    for index, (body_name, object_name) in enumerate(objects.items()):
        add_object(spec, object_name, station.sim.objects, body_name)
        spec.body(body_name).pos = (0.0, 0.0, -index * _APART_M)  # apart, so that they do not touch at the start
    return spec


def _prepare_robot(spec: mujoco.MjSpec, station: Station) -> None:
    """Set weightless links (an arm compensates its own weight), a hand that can grasp, and the pads' friction."""
    for body in spec.bodies:
        if body.name != "world":
            body.gravcomp = 1.0
    hand = spec.actuator(HAND_ACTUATOR)
    hand.gainprm[0] = _HAND_STIFFNESS_N_M
    hand.biasprm[:3] = 0.0, -_HAND_STIFFNESS_N_M, -_HAND_DAMPING_NS_M
    hand.inheritrange = 0.0
    hand.ctrlrange[:] = -0.02, 0.05
    for finger in ("left_finger", "right_finger"):
        _replace_jaw(spec, spec.body(finger), station)
    _simplify_links(spec)


def _soften_touch(spec: mujoco.MjSpec, station: Station) -> None:
    """Let hand and fingers yield on what stands fixed, as rubber tips and elastic joints do; the model has neither.

    Contacts of two rigid bodies would stop all of the arm's inertia, its motors' included, within a millisecond.
    """
    touching = [geom for geom in spec.geoms if geom.group == _COLLISION_GROUP and geom.parent.name in _TOUCHING]
    for index, geom in enumerate(touching):
        geom.name = geom.name or f"hand_{index}"
        for box in scene_boxes(station.scene):
            pair = spec.add_pair(geomname1=geom.name, geomname2=box.name)
            pair.solref, pair.solimp, pair.condim = _TOUCH_SOLREF, _TOUCH_SOLIMP, 3
            pair.friction = [station.sim.friction, station.sim.friction, *_NO_TORSION]


def _simplify_links(spec: mujoco.MjSpec) -> None:
    """Draw the links, which the camera never sees, by their collision geometry.

    Their fine meshes, hundreds of thousands of vertices, took a second of every start, and much memory.
    """
    for body in spec.bodies:
        if not body.name.startswith("fr3_link"):
            continue
        for geom in list(body.geoms):
            if geom.group == _COLLISION_GROUP:
                geom.group, geom.rgba = _VISIBLE_GROUP, _LINK_RGBA
            else:
                spec.delete(geom)
    drawn = {geom.meshname for body in spec.bodies for geom in body.geoms}
    for mesh in list(spec.meshes):
        if mesh.name not in drawn:
            spec.delete(mesh)


def _replace_jaw(spec: mujoco.MjSpec, finger: mujoco.MjsBody, station: Station) -> None:
    """Replace the shipped hull and pads by one flat jaw from root to tip.

    The hull is bulged, so that it can cage a round object from below; on a flat jaw only friction holds.
    """
    for geom in list(finger.geoms):
        if geom.group == _COLLISION_GROUP:
            spec.delete(geom)
    hand, friction = station.hand, station.sim.friction
    finger.add_geom(
        name=f"{finger.name}_jaw",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[hand.finger_width_m / 2, hand.finger_thickness_m / 2, (FINGER_LENGTH_M - _JAW_ROOT_M) / 2],
        pos=[0.0, hand.finger_thickness_m / 2, (FINGER_LENGTH_M + _JAW_ROOT_M) / 2],
        group=_COLLISION_GROUP,
        condim=6,
        priority=1,  # else MuJoCo takes the larger friction of the two, and a slippery pad still holds
        friction=[friction, friction * _TORSION_M, friction * _ROLLING_M],
        solref=_JAW_SOLREF,
        solimp=_JAW_SOLIMP,
    )


def _furnish(spec: mujoco.MjSpec, station: Station) -> None:
    for box in scene_boxes(station.scene):
        _add_box(spec, box, _TABLE_RGBA if box.name == station.scene.table.name else _TRAY_RGBA)
    for side in (-1.0, 1.0):  # from two sides, so that the arm throws no hard shadow on the object
        light = spec.worldbody.add_light(
            name=f"light{side:+.0f}", pos=(0.4, 1.2 * side, 1.8), dir=(0, -0.55 * side, -1)
        )
        light.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
        light.diffuse, light.specular, light.castshadow = (0.38,) * 3, (0.08,) * 3, False


def _add_box(spec: mujoco.MjSpec, box: Box, rgba: tuple[float, ...]) -> None:
    spec.worldbody.add_geom(
        name=box.name,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[side / 2 for side in box.size_m],
        pos=box.center_m,
        rgba=rgba,
    )


def _add_camera(hand: mujoco.MjsBody, name: str, hand_from_camera: np.ndarray, fovy_deg: float) -> None:
    # MuJoCo cameras look along -z with y up; ours along +z with y down.
    rotation = np.ascontiguousarray(hand_from_camera[:3, :3] @ np.diag([1.0, -1.0, -1.0]))
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, rotation.ravel())
    hand.add_camera(name=name, pos=hand_from_camera[:3, 3], quat=quaternion, fovy=fovy_deg)
