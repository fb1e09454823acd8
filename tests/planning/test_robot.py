"""The robot model: equal to MuJoCo's."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import mujoco
import numpy as np
import pytest

from config.franka_hand import FINGER_TIP_M, FINGER_TIP_SIZE_M, HAND_FROM_TCP_M, PALM_ABOVE_TIP_M
from config.limits import LOWER_RAD, UPPER_RAD
from planning.robot import Robot
from tests.planning.conftest import CAPTURE


def random_q(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(LOWER_RAD, UPPER_RAD, (count, 7))


def test_the_hand_is_where_mujoco_puts_it(robot: Robot) -> None:
    assets = Path(str(files("franky_sim"))) / "assets"
    spec = mujoco.MjSpec.from_file(str(assets / "fr3.xml"))
    spec.meshdir = str(assets / "meshes")
    model = spec.compile()
    data = mujoco.MjData(model)
    for q in random_q(1000, seed=1):
        data.qpos[:7] = q
        mujoco.mj_kinematics(model, data)
        pose = robot.base_from_hand(q)
        assert np.abs(pose[:3, 3] - data.body("hand").xpos).max() < 1e-6
        assert np.abs(pose[:3, :3] - data.body("hand").xmat.reshape(3, 3)).max() < 1e-6


def test_the_tcp_is_ahead_of_the_hand_and_the_camera_looks_the_same_way(robot: Robot) -> None:
    hand, tcp, color = (f(CAPTURE) for f in (robot.base_from_hand, robot.base_from_tcp, robot.base_from_color))
    assert np.allclose(np.linalg.inv(hand) @ tcp @ [0, 0, 0, 1], [0, 0, HAND_FROM_TCP_M, 1], atol=1e-12)
    assert np.allclose(tcp[:3, 2], color[:3, 2], atol=1e-12)
    assert np.allclose(color[:3, 1], -hand[:3, 0], atol=1e-12), "image down is hand -x"


def test_the_hand_s_dimensions_are_those_of_its_collision_shapes(robot: Robot) -> None:
    shapes = {part.name: part for part in robot.meshes}
    tip, palm = shapes["fr3_leftfinger_3"], shapes["fr3_hand_0"]
    hand_from_tip = robot.model.frames[robot.hand_frame].placement.inverse() * (
        robot.model.jointPlacements[tip.parentJoint] * tip.placement
    )
    reach_m = hand_from_tip.translation[2] + tip.geometry.halfSide[2] - HAND_FROM_TCP_M
    palm.geometry.computeLocalAABB()
    assert reach_m == pytest.approx(FINGER_TIP_M, abs=1e-4)
    assert 2 * tip.geometry.halfSide[:2] == pytest.approx(FINGER_TIP_SIZE_M)
    assert HAND_FROM_TCP_M + reach_m - palm.geometry.aabb_local.max_[2] == pytest.approx(PALM_ABOVE_TIP_M, abs=5e-4)


def test_the_jacobian_is_the_derivative_of_the_tcp(robot: Robot) -> None:
    step = 1e-6
    numeric = np.stack(
        [(robot.base_from_tcp(CAPTURE + d) - robot.base_from_tcp(CAPTURE - d))[:3, 3] for d in step * np.eye(7)], axis=1
    )
    assert np.abs(numeric / (2 * step) - robot.jacobian(CAPTURE)[:3]).max() < 1e-8


def test_a_weight_on_the_tcp_is_read_back_from_the_torques(robot: Robot) -> None:
    force = np.array([1.0, -2.0, -9.81])
    torque = robot.jacobian(CAPTURE)[:3].T @ force
    assert np.allclose(robot.tcp_force_n(CAPTURE, torque), force, atol=1e-9)
