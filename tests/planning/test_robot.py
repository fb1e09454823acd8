"""The robot model: equal to MuJoCo's, and honest about what touches what."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from config.limits import LOWER_RAD, UPPER_RAD
from config.schema import Box, NodeSettings, SceneSettings, Station
from planning.kinematics import inverse, q7_grid
from planning.path import flange_pose
from planning.robot import FINGER_TIP_M, HAND_FROM_TCP_M, Robot

NODES = {"sim": NodeSettings(driver="sim", serves=("camera", "arm", "hand"))}
STATION = Station(nodes=NODES)
CAPTURE = np.array(STATION.arm.capture_q_rad)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot(STATION)


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


def test_the_capture_pose_is_free(robot: Robot) -> None:
    assert robot.collision(CAPTURE) is None


def reach_down(x_m: float, y_m: float, tip_height_m: float) -> np.ndarray:
    """The configuration nearest to the capture pose that points straight down with its finger tips there."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = x_m, y_m, tip_height_m + FINGER_TIP_M
    solutions = inverse(flange_pose(pose), q7_grid())
    return solutions[np.argmin(np.abs(solutions - CAPTURE).max(axis=1))]


def test_fingers_may_come_within_2_mm_of_the_table_and_no_nearer(robot: Robot) -> None:
    assert robot.collision(reach_down(0.45, 0.0, 0.0022)) is None
    assert robot.collision(reach_down(0.45, 0.0, 0.0018)) in ("left finger touches table", "right finger touches table")


def test_obstacles_keep_the_clearance(robot: Robot) -> None:
    top = robot.base_from_hand(CAPTURE)[:3, 3]
    lens_z = robot.base_from_color(CAPTURE)[:3, 3][2]
    for gap_m, touch in ((0.0045, None), (0.0035, "camera touches shelf")):
        front = lens_z - 0.005 - gap_m
        shelf = Box(name="shelf", center_m=(top[0] + 0.065, 0.0, front - 0.005), size_m=(0.02, 0.02, 0.01))
        station = Station(nodes=NODES, scene=SceneSettings(obstacles=(shelf,)))
        assert Robot(station).collision(CAPTURE) == touch


def test_an_obstacle_may_have_any_name() -> None:
    around_hand = Box(name="camera", center_m=(0.375, 0.0, 0.6), size_m=(0.3, 0.3, 0.1))
    station = Station(nodes=NODES, scene=SceneSettings(obstacles=(around_hand,)))
    assert Robot(station).collision(CAPTURE) is not None


def test_the_tray_has_walls(robot: Robot) -> None:
    over_wall = (0.40, 0.34 + 0.0475)  # one finger above the wall, the other above the floor
    assert robot.collision(reach_down(*over_wall, 0.063)) is None
    assert "finger touches tray-right" in str(robot.collision(reach_down(*over_wall, 0.061)))
    flat = Robot(Station(nodes=NODES, scene=SceneSettings(tray_wall_height_m=0.0)))
    assert flat.collision(reach_down(*over_wall, 0.023)) is None
    assert "finger touches tray" in str(flat.collision(reach_down(*over_wall, 0.021)))


def test_the_width_of_the_hand_counts(robot: Robot) -> None:
    tcp = robot.base_from_tcp(CAPTURE)[:3, 3]
    post = Box(name="post", center_m=(tcp[0], 0.065, tcp[2]), size_m=(0.01, 0.01, 0.03))
    tight = Robot(Station(nodes=NODES, scene=SceneSettings(obstacles=(post,))))
    assert "finger touches post" in str(tight.collision(CAPTURE))
    assert tight.collision(CAPTURE, width_m=0.04) is None


def test_unchecked_pairs_of_parts_are_neighbours_or_never_meet(robot: Robot) -> None:
    """Every pair of parts that is not checked is either mounted together or next to each other in the chain."""
    chain = {f"link {i}": i for i in range(8)} | dict.fromkeys(("hand", "camera", "left finger", "right finger"), 8)
    checked = {frozenset(pair) for pair in robot.self_collision_pairs()}
    unchecked = {frozenset((a, b)) for a in chain for b in chain if a < b and frozenset((a, b)) not in checked}
    assert all(abs(chain[a] - chain[b]) <= 1 or {a, b} == {"link 5", "link 7"} for a, b in map(sorted, unchecked))
    assert len(checked) == 66 - len(unchecked)


def test_checked_pairs_of_parts_do_not_collide_everywhere(robot: Robot) -> None:
    touches = [robot.collision(q) for q in random_q(500, seed=2)]
    own = [t for t in touches if t is not None and not any(s in t for s in ("table", "tray"))]
    assert 0 < len(own) < 100


def test_the_broad_phase_misses_nothing(robot: Robot) -> None:
    """Against exact distances of every checked pair, at configurations near the scene."""
    model, geometry = robot._model, robot._geometry  # the same pairs, another algorithm
    data = geometry.createData()
    margins = [request.security_margin for request in robot._geometry_data.collisionRequests]
    rng = np.random.default_rng(3)
    seen = set()
    for _ in range(60):
        q = np.clip(CAPTURE + rng.normal(0, [0.6, 0.6, 0.4, 0.5, 0.6, 0.6, 1]), LOWER_RAD, UPPER_RAD)
        pin.computeDistances(model, model.createData(), geometry, data, np.concatenate([q, [0.04, 0.04]]))
        gaps = np.array([result.min_distance for result in data.distanceResults])
        near = bool((gaps < margins).any())
        seen.add(near)
        assert (robot.collision(q) is not None) == near
    assert seen == {True, False}
