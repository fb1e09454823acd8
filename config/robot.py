"""The arm of a station: its joints, their limits, and the file that describes its links. Without one: the FR3."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, Protocol

from pydantic import Field, model_validator

from bus.lazy import LazyModule
from config.base import Finite, Positive, Settings, SystemPath

if TYPE_CHECKING:
    from config.limits import JointLimits

# Imported when limits are asked for, so that a program that only sends "stop" does not wait for them.
numpy: Any = LazyModule("numpy")
limits: Any = LazyModule("config.limits")


HalfTurn = Annotated[Finite, Field(ge=-3.14, le=3.14)]


class JointSettings(Settings):
    """One joint of the arm, from the base on.

    Attributes:
        name: in the URDF. ``lower_rad``, ``upper_rad``: its range, less than a turn.
        speed_rad_s, acceleration_rad_s2, jerk_rad_s3: no motion is faster, at 1 kHz, as for the FR3.
        stiffness_nm_rad: of its servo in the simulated cell.
    """

    name: str
    lower_rad: HalfTurn
    upper_rad: HalfTurn
    speed_rad_s: Positive
    acceleration_rad_s2: Positive = 10.0
    jerk_rad_s3: Positive = 5000.0
    stiffness_nm_rad: Positive = 4000.0

    @model_validator(mode="after")
    def _is_a_range(self) -> JointSettings:
        if self.lower_rad >= self.upper_rad:
            raise ValueError("lower_rad must be below upper_rad")
        return self


class RobotSettings(Settings):
    """An arm of six joints with the Franka hand on its flange; without this table the arm is the Franka Research 3.

    The links of its URDF are called ``link0`` (the base) to ``link6``, each turned by its joint about its z axis; the
    hand is mounted on ``flange``, turned by -45 degrees about its z axis as on the FR3. Shapes are boxes.

    Attributes:
        urdf: its file, beside the station file.
        joints: all six, from the base on.
    """

    urdf: SystemPath
    joints: Annotated[tuple[JointSettings, ...], Field(min_length=6, max_length=6)]


class _WithRobot(Protocol):
    """A station."""

    @property
    def robot(self) -> RobotSettings | None:
        """Its arm; None = the FR3."""


def limits_of(station: _WithRobot) -> JointLimits:
    """Return the joint limits of the station's arm."""
    fr3: JointLimits = limits.FR3
    return fr3 if station.robot is None else _limits(station.robot.joints)


def recorded_limits(station: Mapping[str, Any]) -> JointLimits:
    """Return the joint limits of the arm of a recorded station. Raises: ValueError when its robot is none."""
    fr3: JointLimits = limits.FR3
    robot = station.get("robot")
    return fr3 if robot is None else _limits(RobotSettings.model_validate(robot).joints)


@lru_cache(maxsize=8)
def _limits(joints: tuple[JointSettings, ...]) -> JointLimits:
    def of(name: str) -> Any:
        return numpy.array([getattr(joint, name) for joint in joints])

    found: JointLimits = limits.JointLimits(
        of("lower_rad"),
        of("upper_rad"),
        of("speed_rad_s"),
        of("acceleration_rad_s2"),
        of("jerk_rad_s3"),
        2 * of("acceleration_rad_s2"),
    )
    return found
