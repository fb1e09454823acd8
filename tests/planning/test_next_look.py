"""Where the camera looks from next: a fixed order of places, each taken once, and no way there through the unseen."""

from __future__ import annotations

import numpy as np
import pytest

from bus.cancel import Cancel
from bus.codes import Code
from bus.errors import CycleFailure
from bus.transforms import direction_of_view_deg
from config.scene import Box, SceneSettings, scene_boxes
from config.schema import Station
from planning.looks import Viewpoint, next_look, unseen
from planning.robot import Robot
from planning.scene import Scene
from planning.viewpoints import looking_at
from tests.planning.conftest import CAPTURE, NODES, STATION, box

LEFT, RIGHT = (45.0, 120.0), (45.0, 240.0)
WALL = box("wall", (0.2, 0.45, 0.5), (0.5, 0.02, 0.8))
"""It stands where the camera would look from the left."""


def _among(robot: Robot, *obstacles: Box, station: Station = STATION, cancel: Cancel | None = None) -> Scene:
    boxes = (*scene_boxes(station.scene), unseen(station), *obstacles)
    return Scene.of(robot, station, boxes=boxes, cancel=cancel)


def _direction(one: Viewpoint) -> tuple[float, float]:
    return (one.tilt_deg, one.azimuth_deg)


def _all_looks(robot: Robot, scene: Scene) -> tuple[list[Viewpoint], CycleFailure]:
    """Looks from one place after another until there is none, and what is then said."""
    q_rad, taken, found = CAPTURE, [direction_of_view_deg(robot.base_from_color(CAPTURE))], list[Viewpoint]()
    with pytest.raises(CycleFailure) as none_left:
        while True:
            found.append(next_look(scene, q_rad, taken))
            q_rad = found[-1].motion.end_q_rad
            taken.append(direction_of_view_deg(robot.base_from_color(q_rad)))
    return found, none_left.value


@pytest.mark.parametrize("direction", [(0.0, 0.0), LEFT, RIGHT, (30.0, 180.0), (20.0, 359.0)])
def test_the_direction_of_a_view_is_that_which_it_was_made_for(direction: tuple[float, float]) -> None:
    tilt_deg, azimuth_deg = direction_of_view_deg(looking_at(np.array([0.4, 0.1, 0.0]), 0.6, *direction, roll_deg=35.0))
    assert tilt_deg == pytest.approx(direction[0], abs=1e-4)
    assert tilt_deg < 1 or azimuth_deg == pytest.approx(direction[1], abs=1e-4)


def test_the_first_place_is_at_45_degrees_on_the_left_and_looks_at_the_middle_of_the_region(robot: Robot) -> None:
    first = next_look(_among(robot), CAPTURE, [direction_of_view_deg(robot.base_from_color(CAPTURE))])
    assert _direction(first) == LEFT and np.array_equal(first.motion.start_q_rad, CAPTURE)
    base_from_color = robot.base_from_color(first.motion.end_q_rad)
    assert direction_of_view_deg(base_from_color) == pytest.approx(LEFT, abs=0.01)
    x_min, x_max, y_min, y_max = STATION.scene.pick_region_m
    x, y, z = np.linalg.inv(base_from_color) @ [(x_min + x_max) / 2, (y_min + y_max) / 2, 0.03, 1.0] @ np.eye(4, 3)
    assert np.hypot(x, y) < 1e-6 and STATION.camera.least_range_m is not None
    assert STATION.camera.least_range_m < z < 0.71, "far enough to be measured"


def test_no_place_is_taken_twice_nor_one_beside_it(robot: Robot) -> None:
    found, none_left = _all_looks(robot, _among(robot))
    assert [_direction(one) for one in found[:2]] == [LEFT, RIGHT]
    axes = [robot.base_from_color(one.motion.end_q_rad)[:3, 2] for one in found]
    apart_deg = [np.degrees(np.arccos(a @ b)) for index, a in enumerate(axes) for b in axes[:index]]
    assert len(found) >= 3 and min(apart_deg) >= 24.9
    assert none_left.failure is Code.UNREACHABLE and "all of them were taken" in none_left.text


def test_a_place_that_cannot_be_reached_is_passed_over(robot: Robot) -> None:
    first = next_look(_among(robot, WALL), CAPTURE, [])
    assert _direction(first) == RIGHT


def test_when_none_can_be_reached_the_obstacle_is_named(robot: Robot) -> None:
    below = box("shelf", (0.385, 0.0, 0.56), (0.2, 0.2, 0.1))
    with pytest.raises(
        CycleFailure, match=r"reaches no other place to look from: .*cannot start.*touches shelf"
    ) as why:
        next_look(_among(robot, below), CAPTURE, [])
    assert why.value.failure is Code.UNREACHABLE


def test_the_hand_and_the_camera_stay_out_of_what_may_stand_unseen_in_the_region(robot: Robot) -> None:
    """Where objects may be 0.5 m high, the short way from the left to the right leads through their space."""
    high = Station(nodes=NODES, scene=SceneSettings(max_height_m=0.5))
    left = next_look(_among(robot, station=high), CAPTURE, [])
    q_rad, taken = left.motion.end_q_rad, [LEFT]
    around = next_look(_among(robot, station=high), q_rad, taken)
    through = next_look(Scene.of(robot, high), q_rad, taken)
    assert _direction(around) == _direction(through) == RIGHT
    assert _ever_inside(robot, through, unseen(high)) and not _ever_inside(robot, around, unseen(high))


def _ever_inside(robot: Robot, look: Viewpoint, space: Box) -> bool:
    """Whether the tcp or the camera passes through a box."""
    commands = look.motion.filtered()[::5]
    at = np.array([pose[:3, 3] for q in commands for pose in (robot.base_from_tcp(q), robot.base_from_color(q))])
    return bool((np.abs(at - space.center_m) < np.array(space.size_m) / 2).all(axis=1).any())


def test_a_stop_ends_the_search(robot: Robot) -> None:
    cancel = Cancel()
    cancel.set()
    with pytest.raises(CycleFailure) as stopped:
        next_look(_among(robot, cancel=cancel), CAPTURE, [])
    assert stopped.value.failure is Code.STOPPED


def test_a_stop_during_the_last_motion_is_no_place_out_of_reach(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*_: object) -> None:
        raise CycleFailure(Code.STOPPED, "Stopped during 'plan'.")

    monkeypatch.setattr("planning.looks.move", stopped)
    with pytest.raises(CycleFailure) as caught:
        next_look(_among(robot), CAPTURE, [])
    assert caught.value.failure is Code.STOPPED
