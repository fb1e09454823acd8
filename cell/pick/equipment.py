"""The equipment of a cycle."""

from __future__ import annotations

from dataclasses import dataclass, field

from cell.pick.mounting import MountKeeper
from config.schema import Station
from drivers.interface import Arm, Camera, Hand
from perception.models import Models
from planning.robot import Robot


@dataclass(frozen=True)
class Equipment:
    """The devices, models and settings of a cycle."""

    camera: Camera
    arm: Arm
    hand: Hand
    robot: Robot
    station: Station
    models: Models
    mounting: MountKeeper = field(default_factory=MountKeeper)
