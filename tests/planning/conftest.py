"""One robot and the default cell for all tests of planning."""

from __future__ import annotations

import numpy as np
import pytest

from config.devices import NodeSettings
from config.scene import Box, SceneSettings
from config.schema import Station
from planning.robot import Robot
from planning.scene import Scene

NODES = {"sim": NodeSettings(driver="sim", serves=("camera", "arm", "hand"))}
STATION = Station(nodes=NODES)
CAPTURE = np.array(STATION.arm.capture_q_rad)
WIDE_M = STATION.hand.max_width_m


@pytest.fixture(scope="session")
def robot() -> Robot:
    return Robot(STATION)


@pytest.fixture(scope="session")
def scene(robot: Robot) -> Scene:
    return Scene.of(robot, STATION)


def among(robot: Robot, *obstacles: Box) -> Scene:
    """The default cell with more boxes in it."""
    return Scene.of(robot, Station(nodes=NODES, scene=SceneSettings(obstacles=obstacles)))


def box(name: str, center_m: tuple[float, float, float], size_m: tuple[float, float, float]) -> Box:
    return Box(name=name, center_m=center_m, size_m=size_m)
