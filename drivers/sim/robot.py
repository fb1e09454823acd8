"""The robot of the simulated cell: the FR3 as it is shipped, or the arm of ``[robot]`` with the same hand."""

from __future__ import annotations

import importlib.resources
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import mujoco

from bus.errors import ConfigError
from config.robot import RobotSettings
from config.schema import Station

_log = logging.getLogger(__name__)

_ASSETS = Path(str(importlib.resources.files("franky_sim"))) / "assets"
_DAMPING_S = 0.1
"""Damping of a servo over its stiffness, as of the FR3's."""
_ARMATURE_KG_M2, _FRICTION_NM = 0.15, 0.5
"""Of the motors and gears of an arm that is not the FR3: about what the FR3's joints have."""
_VISIBLE_GROUP = 2
_UNSAVED = "empty prefix"
_LINK_RGBA = (0.90, 0.92, 0.93, 1.0)


def arm_joints(station: Station) -> tuple[str, ...]:
    """Return the names of the arm's joints in the model, base to wrist; each has a position actuator of its name."""
    if station.robot is None:
        return tuple(f"fr3_joint{index}" for index in range(1, 8))
    return tuple(joint.name for joint in station.robot.joints)


def robot_spec(station: Station) -> mujoco.MjSpec:
    """Return the robot alone. Raises: ConfigError when MuJoCo cannot read the arm's URDF."""
    fr3 = mujoco.MjSpec.from_file(str(_ASSETS / "fr3.xml"))
    fr3.meshdir = str(_ASSETS / "meshes")
    return fr3 if station.robot is None else _with_hand(station.robot, fr3)


@contextmanager
def joined_models() -> Iterator[None]:
    """Context in which two models are joined and compiled: MuJoCo warns, in two ways, that none could be saved."""
    mujoco.set_mju_user_warning(lambda text: None if _UNSAVED in text else _log.warning("MuJoCo: %s", text))
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=f".*{_UNSAVED}")
            yield
    finally:
        mujoco.set_mju_user_warning(None)


def _with_hand(robot: RobotSettings, fr3: mujoco.MjSpec) -> mujoco.MjSpec:
    try:
        spec = mujoco.MjSpec.from_file(str(robot.urdf))
    except ValueError as error:
        raise ConfigError(f"robot.urdf: MuJoCo cannot read {robot.urdf}: {error}.", "Correct the file.") from error
    flange = spec.body("flange")
    if flange is None:
        what = f"MuJoCo has merged the flange of {robot.urdf} into the link before it."
        raise ConfigError(what, 'Write <mujoco><compiler fusestatic="false"/></mujoco> into it.')
    spec.compiler.discardvisual = False  # as it is read, a URDF's: the hand would not be seen
    spec.option.integrator = fr3.option.integrator
    hand = fr3.body("hand")
    hand.pos = (0.0, 0.0, 0.0)  # of the FR3's last link it is the flange; it is turned as there
    with joined_models():
        flange.add_frame().attach_body(hand, "", "")
    for body in spec.bodies:
        for geom in body.geoms:
            if body.name.startswith("link"):
                geom.group, geom.rgba = _VISIBLE_GROUP, _LINK_RGBA
    spec.add_exclude(bodyname1="link0", bodyname2="link1")
    for joint in robot.joints:
        _drive(spec, joint.name, joint.stiffness_nm_rad)
    return spec


def _drive(spec: mujoco.MjSpec, name: str, stiffness_nm_rad: float) -> None:
    """Give a joint a position servo of its name, and what its motor and gear add."""
    joint = spec.joint(name)
    joint.armature, joint.frictionloss = _ARMATURE_KG_M2, _FRICTION_NM
    servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.gaintype, servo.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
    servo.gainprm[0] = stiffness_nm_rad
    servo.biasprm[:3] = 0.0, -stiffness_nm_rad, -_DAMPING_S * stiffness_nm_rad
