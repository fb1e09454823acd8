"""Who touches whom: pairs that are checked, margins, and words for what is touched."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pinocchio as pin
import pytest

from config.devices import NodeSettings
from config.franka_hand import FINGER_TIP_M
from config.limits import LOWER_RAD, UPPER_RAD
from config.scene import SceneSettings
from config.schema import Station
from planning.kinematics import inverse, q7_grid
from planning.robot import Robot, flange_pose, part_name
from planning.scene import Scene
from planning.sweep import WIDE_MARGINS_M
from planning.world import World
from tests.planning.conftest import CAPTURE, WIDE_M, among, box

PARTS = ("link 0", "link 1", "link 2", "link 3", "link 4", "link 5", "link 6", "link 7", "hand", "camera",
         "left finger", "right finger")  # fmt: skip


def random_q(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(LOWER_RAD, UPPER_RAD, (count, 7))


def near_q(count: int, seed: int) -> np.ndarray:
    spread = [0.6, 0.6, 0.4, 0.5, 0.6, 0.6, 1.0]
    return np.clip(CAPTURE + np.random.default_rng(seed).normal(0, spread, (count, 7)), LOWER_RAD, UPPER_RAD)


def reach_down(x_m: float, y_m: float, tip_height_m: float) -> np.ndarray:
    """The configuration nearest to the capture pose that points straight down with its finger tips there."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = x_m, y_m, tip_height_m + FINGER_TIP_M
    solutions = inverse(flange_pose(pose), q7_grid())
    nearest: np.ndarray = solutions[np.argmin(np.abs(solutions - CAPTURE).max(axis=1))]
    return nearest


def alone(robot: Robot, parts: tuple[pin.GeometryObject, ...], margin_m: float = 0.0) -> World:
    return World(robot, parts, (), margin_m=margin_m, finger_margin_m=margin_m)


def test_the_capture_pose_is_free(scene: Scene) -> None:
    assert scene.collision(CAPTURE, WIDE_M) is None


def test_fingers_may_come_within_2_mm_of_the_table_and_no_nearer(scene: Scene) -> None:
    assert scene.collision(reach_down(0.45, 0.0, 0.0024), WIDE_M) is None
    assert "finger touches table" in str(scene.collision(reach_down(0.45, 0.0, 0.0018), WIDE_M))


def test_obstacles_keep_the_clearance(robot: Robot) -> None:
    top = robot.base_from_hand(CAPTURE)[:3, 3]
    lens_z = robot.base_from_color(CAPTURE)[2, 3]
    for gap_m, collision in ((0.0045, "None"), (0.0035, "camera touches shelf")):
        shelf = box("shelf", (top[0] + 0.065, 0.0, lens_z - 0.01 - gap_m), (0.02, 0.02, 0.01))
        assert str(among(robot, shelf).collision(CAPTURE, WIDE_M)) == collision


def test_an_obstacle_may_have_the_name_of_a_part(robot: Robot) -> None:
    assert among(robot, box("camera", (0.375, 0.0, 0.6), (0.3, 0.3, 0.1))).collision(CAPTURE, WIDE_M) is not None


def test_the_tray_has_walls(robot: Robot, scene: Scene) -> None:
    over_wall = (0.40, 0.34 + 0.0475)  # one finger above the wall, the other above the floor
    assert scene.collision(reach_down(*over_wall, 0.063), WIDE_M) is None
    assert "finger touches tray-right" in str(scene.collision(reach_down(*over_wall, 0.061), WIDE_M))
    nodes = {"sim": NodeSettings(driver="sim", serves=("camera", "arm", "hand"))}
    flat = Scene.of(robot, Station(nodes=nodes, scene=SceneSettings(tray_wall_height_m=0.0)))
    assert flat.collision(reach_down(*over_wall, 0.023), WIDE_M) is None
    assert "finger touches tray" in str(flat.collision(reach_down(*over_wall, 0.021), WIDE_M))


def test_the_width_of_the_hand_counts(robot: Robot) -> None:
    tcp = robot.base_from_tcp(CAPTURE)[:3, 3]
    tight = among(robot, box("post", (tcp[0], 0.065, tcp[2]), (0.01, 0.01, 0.03)))
    assert "finger touches post" in str(tight.collision(CAPTURE, WIDE_M))
    assert tight.collision(CAPTURE, 0.04) is None


def test_a_hand_of_any_width_touches_what_its_fingers_pass_on_their_way(robot: Robot) -> None:
    """A thin post is free of the closed and of the open hand, but not of one that opens there."""
    tcp = robot.base_from_tcp(CAPTURE)[:3, 3]
    thin = among(robot, box("post", (tcp[0], 0.022, tcp[2]), (0.004, 0.004, 0.01)))
    assert thin.collision(CAPTURE, 0.0) is None and thin.collision(CAPTURE, WIDE_M) is None
    assert "finger touches post" in str(thin.collision(CAPTURE, None))
    assert "finger touches post" in str(thin.first_collision(CAPTURE[None], None))
    assert "finger touches post" in str(thin.gate(CAPTURE[None], None))


def test_what_is_free_at_any_width_is_free_at_each(robot: Robot) -> None:
    around = robot.base_from_tcp(CAPTURE)[:3, 3]
    rng = np.random.default_rng(7)
    free = 0
    for _ in range(60):
        crumb = among(robot, box("crumb", tuple(around + rng.uniform(-0.06, 0.06, 3)), (0.006, 0.006, 0.006)))
        if crumb.collision(CAPTURE, None) is None:
            free += 1
            assert all(crumb.collision(CAPTURE, width_m) is None for width_m in np.linspace(0.0, WIDE_M, 17))
            assert all(crumb.gate(CAPTURE[None], width_m) is None for width_m in np.linspace(0.0, WIDE_M, 17))
    assert 10 < free < 60


def test_every_unchecked_pair_is_mounted_together_adjacent_or_never_meets(robot: Robot) -> None:
    """What is left out is derived here anew: neighbours of the chain, the hand's parts, and link 5 against link 7."""
    place = {name: min(index, 8) for index, name in enumerate(PARTS)}
    on_hand = {"link 7", *PARTS[8:]}
    expected = {
        frozenset(pair)
        for pair in combinations(PARTS, 2)
        if abs(place[pair[0]] - place[pair[1]]) <= 1 or set(pair) <= on_hand or set(pair) == {"link 5", "link 7"}
    }
    checked = alone(robot, robot.meshes).own_pairs()
    assert {frozenset(pair) for pair in combinations(PARTS, 2)} - checked == expected


def test_link_5_and_link_7_never_meet(robot: Robot) -> None:
    parts = [part for part in robot.meshes if part_name(part.name) in ("link 5", "link 7")]
    model = pin.GeometryModel()
    for part in parts:
        model.addGeometryObject(part)
    for a, b in combinations(range(len(parts)), 2):
        if part_name(parts[a].name) != part_name(parts[b].name):
            model.addCollisionPair(pin.CollisionPair(a, b))
    data, geometry = robot.model.createData(), model.createData()
    for q6 in np.linspace(LOWER_RAD[5], UPPER_RAD[5], 60):
        for q7 in np.linspace(LOWER_RAD[6], UPPER_RAD[6], 20):
            full = np.array([*CAPTURE[:5], q6, q7, 0.0, 0.0])
            assert not pin.computeCollisions(robot.model, data, model, geometry, full, True)


def test_no_checked_pair_is_in_contact_everywhere(robot: Robot) -> None:
    world = alone(robot, robot.hulls)
    touches = [q for q in random_q(500, seed=2) if world.collision(q, WIDE_M) is not None]
    assert 0 < len(touches) < 100


def test_the_hulls_contain_the_meshes(robot: Robot) -> None:
    hulls, meshes = alone(robot, robot.hulls), alone(robot, robot.meshes)
    colliding = [q for q in random_q(1500, seed=5) if meshes.collision(q, WIDE_M) is not None]
    assert len(colliding) > 30
    assert all(hulls.collision(q, WIDE_M) is not None for q in colliding)


def test_the_broad_phase_misses_nothing(robot: Robot, scene: Scene) -> None:
    """Against exact distances of every checked pair, at configurations near the scene."""
    world = scene._planned  # the same pairs, another algorithm
    model, (geometry, _) = world._model, world._fine
    margins = [request.security_margin for request in geometry.collisionRequests]
    data, robot_data, seen = model.createData(), robot.model.createData(), set()
    for q in near_q(60, seed=3):
        pin.computeDistances(robot.model, robot_data, model, data, np.array([*q, WIDE_M / 2, WIDE_M / 2]))
        near = any(r.min_distance < margin for r, margin in zip(data.distanceResults, margins, strict=True))
        seen.add(near)
        assert (scene.collision(q, WIDE_M) is not None) == near
    assert seen == {True, False}


@pytest.mark.parametrize("wide", range(len(WIDE_MARGINS_M)))
def test_a_wider_margin_finds_whatever_the_fine_one_does(scene: Scene, wide: int) -> None:
    for q in near_q(200, seed=4):
        if scene._planned.collision(q, WIDE_M) is not None:
            assert scene._planned.collision(q, WIDE_M, wide=wide) is not None
