"""The camera on the wrist sees the arm it hangs on: its own body is no obstacle, whatever stands beside it is one."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from config.scene import Box
from planning.height_field import Sight
from planning.own_body import on_robot
from planning.robot import Robot
from planning.scene import Scene
from tests.planning.conftest import CAPTURE, STATION, WIDE_M, box
from tests.planning.views import seen_from_above

FROM_ASIDE_M = (0.22, 0.42, 0.90)
BASE = box("base", (-0.03, 0.0, 0.06), (0.18, 0.18, 0.12))


def _among(robot: Robot, *seen: Box, q_rad: np.ndarray | None = CAPTURE) -> Scene:
    points, nothing = seen_from_above((STATION.scene.table, *seen), eye_m=FROM_ASIDE_M)
    return Scene.of(robot, STATION, Sight(points, nothing, q_rad))


def test_the_base_of_the_arm_is_no_obstacle_to_it(robot: Robot) -> None:
    assert _among(robot, BASE).collision(CAPTURE, WIDE_M) is None
    not_told = _among(robot, BASE, q_rad=None).collision(CAPTURE, WIDE_M)
    assert str(not_told) == "link 0 touches an observed obstacle"


def test_what_stands_beside_the_arm_stays_an_obstacle(robot: Robot) -> None:
    aside = CAPTURE + np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    x, y, z = robot.base_from_tcp(aside)[:3, 3]
    seen = _among(robot, BASE, box("post", (x, y, z / 2), (0.06, 0.06, z)))
    assert seen.collision(CAPTURE, WIDE_M) is None
    assert "touches an observed obstacle" in str(seen.collision(aside, WIDE_M))


def test_every_part_is_where_the_arm_stood_when_it_looked(robot: Robot) -> None:
    moved = CAPTURE + np.array([0.8, 0.3, 0.0, 0.4, 0.2, 0.0, 0.0])
    for q_rad in (CAPTURE, moved):
        surface = _surface(robot, q_rad)
        assert on_robot(robot, q_rad, surface).all()
    assert not on_robot(robot, moved, _surface(robot, CAPTURE)).all()


def test_what_has_no_depth_or_lies_apart_is_not_the_arms(robot: Robot) -> None:
    points = np.array([[[np.nan] * 3, [0.30, 0.0, 0.01]], [[0.0, 0.25, 0.05], [0.0, 0.0, 0.05]]], dtype=np.float32)
    assert on_robot(robot, CAPTURE, points).tolist() == [[False, False], [False, True]]


def _surface(robot: Robot, q_rad: np.ndarray) -> np.ndarray:
    """Corners (n, 3) in ``base`` of all parts' convex hulls."""
    data, parts = robot.model.createData(), robot.hulls
    pin.forwardKinematics(robot.model, data, np.concatenate([q_rad, np.full(2, WIDE_M / 2)]))
    corners = [
        np.array((data.oMi[part.parentJoint] * part.placement).act(corner))
        for part in parts
        if hasattr(part.geometry, "points")
        for corner in part.geometry.points()
    ]
    return np.array(corners, dtype=np.float32)
