"""Places to look at a calibration board from."""

from __future__ import annotations

import numpy as np
import pytest

from bus.errors import CalibrationError
from config.calibration import CalibrationSettings
from config.schema import Station
from drivers.sim.optics import COLOR
from planning.robot import Robot
from planning.scene import Scene
from planning.viewpoints import viewpoints
from tests.planning.conftest import CAPTURE, NODES, STATION, WIDE_M


def test_all_of_the_board_is_seen_from_many_sides_and_nothing_is_touched(robot: Robot, scene: Scene) -> None:
    found = viewpoints(scene, STATION, CAPTURE)
    assert len(found) == STATION.calibration.poses
    length_m, width_m = STATION.calibration.size_m
    center_m = np.array(STATION.calibration.board_center_m)
    sides = [(x, y, 0) for x in (-1, 1) for y in (-1, 1)]
    corners_m = center_m + np.array(sides) * (length_m / 2, width_m / 2, 0.0)
    axes = []
    for q_rad in found:
        assert scene.collision(q_rad, WIDE_M) is None
        color_from_base = np.linalg.inv(robot.base_from_color(q_rad))
        seen = corners_m @ color_from_base[:3, :3].T + color_from_base[:3, 3]
        pixels = seen[:, :2] / seen[:, 2:] * COLOR.fx + (COLOR.cx, COLOR.cy)
        assert (pixels > 0).all() and (pixels < (COLOR.width, COLOR.height)).all()
        axes.append(robot.base_from_color(q_rad)[:3, 2])
    apart_deg = np.rad2deg(np.arccos(np.clip(np.array(axes) @ np.array(axes).T, -1, 1)))
    assert apart_deg.max() > 40


def test_a_board_out_of_reach_is_refused_with_what_to_do(robot: Robot) -> None:
    far = Station(nodes=NODES, calibration=CalibrationSettings(board_center_m=(1.4, 0.0, 0.0)))
    with pytest.raises(CalibrationError, match="board_center_m"):
        viewpoints(Scene.of(robot, far), far, CAPTURE)
