"""Lines in joint space and of the tcp."""

from __future__ import annotations

import numpy as np
import pytest

from config.schema import Box, NodeSettings, SceneSettings, Station
from planning.path import first_collision, flange_pose, tcp_line
from planning.robot import Robot

NODES = {"sim": NodeSettings(driver="sim", serves=("camera", "arm", "hand"))}
STATION = Station(nodes=NODES)
CAPTURE = np.array(STATION.arm.capture_q_rad)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot(STATION)


def test_the_flange_pose_brings_the_tcp_to_its_place(robot: Robot) -> None:
    assert np.allclose(flange_pose(robot.base_from_tcp(CAPTURE)), robot.base_from_flange(CAPTURE), atol=1e-12)


def test_a_tcp_line_is_straight_keeps_its_orientation_and_ends_exactly(robot: Robot) -> None:
    start, shift = robot.base_from_tcp(CAPTURE), np.array([0.05, -0.03, -0.2])
    line = tcp_line(CAPTURE, start, shift)
    assert line is not None
    assert np.array_equal(line[0], CAPTURE)
    for share, q in zip(np.linspace(0, 1, len(line)), line, strict=True):
        pose = robot.base_from_tcp(q)
        assert np.abs(pose[:3, 3] - start[:3, 3] - share * shift).max() < 1e-9
        assert np.abs(pose[:3, :3] - start[:3, :3]).max() < 1e-9
    assert (line[:, 6] == CAPTURE[6]).all()


def test_a_tcp_line_out_of_reach_is_none(robot: Robot) -> None:
    assert tcp_line(CAPTURE, robot.base_from_tcp(CAPTURE), np.array([1.0, 0.0, 0.0])) is None


def test_a_tcp_line_out_of_the_joint_limits_is_none(robot: Robot) -> None:
    assert tcp_line(CAPTURE, robot.base_from_tcp(CAPTURE), np.array([-0.1, 0.0, 0.35])) is None


def test_a_thin_obstacle_on_the_way_is_found(robot: Robot) -> None:
    turned = CAPTURE + np.array([1.0, 0, 0, 0, 0, 0, 0])
    middle = robot.base_from_tcp(CAPTURE + np.array([0.5, 0, 0, 0, 0, 0, 0]))[:3, 3]
    sheet = Box(name="sheet", center_m=tuple(middle), size_m=(0.001, 0.001, 0.001))
    crowded = Robot(Station(nodes=NODES, scene=SceneSettings(obstacles=(sheet,))))
    ends = np.stack([CAPTURE, turned])
    assert crowded.collision(CAPTURE) is None
    assert crowded.collision(turned) is None
    assert first_collision(robot, ends) is None
    assert "touches sheet" in str(first_collision(crowded, ends))


def test_a_path_of_one_point_is_checked_too() -> None:
    around = Box(name="block", center_m=(0.375, 0.0, 0.6), size_m=(0.3, 0.3, 0.1))
    crowded = Robot(Station(nodes=NODES, scene=SceneSettings(obstacles=(around,))))
    assert "touches block" in str(first_collision(crowded, CAPTURE[None]))
