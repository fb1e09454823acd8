"""Straight lines of the tcp."""

from __future__ import annotations

import numpy as np

from planning.kinematics import FR3_ARM
from planning.line import tcp_line
from planning.robot import Robot, flange_pose
from tests.planning.conftest import CAPTURE


def test_the_flange_pose_brings_the_tcp_to_its_place(robot: Robot) -> None:
    assert np.allclose(flange_pose(robot.base_from_tcp(CAPTURE)), robot.base_from_flange(CAPTURE), atol=1e-12)


def test_a_tcp_line_is_straight_keeps_its_orientation_and_ends_exactly(robot: Robot) -> None:
    start, shift = robot.base_from_tcp(CAPTURE), np.array([0.05, -0.03, -0.2])
    line = tcp_line(FR3_ARM, CAPTURE, start, shift)
    assert line is not None
    assert np.array_equal(line[0], CAPTURE)
    for share, q in zip(np.linspace(0, 1, len(line)), line, strict=True):
        pose = robot.base_from_tcp(q)
        assert np.abs(pose[:3, 3] - start[:3, 3] - share * shift).max() < 1e-9
        assert np.abs(pose[:3, :3] - start[:3, :3]).max() < 1e-9
    assert (line[:, 6] == CAPTURE[6]).all()


def test_a_tcp_line_out_of_reach_is_none(robot: Robot) -> None:
    assert tcp_line(FR3_ARM, CAPTURE, robot.base_from_tcp(CAPTURE), np.array([1.0, 0.0, 0.0])) is None


def test_a_tcp_line_out_of_the_joint_limits_is_none(robot: Robot) -> None:
    assert tcp_line(FR3_ARM, CAPTURE, robot.base_from_tcp(CAPTURE), np.array([-0.1, 0.0, 0.35])) is None
