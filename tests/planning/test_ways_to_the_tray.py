"""The object is held above the tray: the way there is direct, and the one to the viewpoint is planned with all else."""

from __future__ import annotations

import numpy as np
import pytest

from bus.messages import PickPlan
from config.pick import VerifySettings
from config.scene import SceneSettings
from config.schema import Station
from planning.pick import plan_pick
from planning.pregrasp import LOWER_M
from planning.robot import Robot
from planning.scene import Scene
from tests.planning.conftest import CAPTURE, NODES, STATION, box
from tests.planning.test_pick import GOOD, ends, grasp

AUTO = VerifySettings(look="auto")


@pytest.fixture(scope="module")
def direct(robot: Robot) -> PickPlan:
    return plan_pick(Scene.of(robot, Station(nodes=NODES, verify=AUTO)), [GOOD], CAPTURE)


def starts(plan: PickPlan) -> dict[str, np.ndarray]:
    return {segment.name: segment.trajectory.start_q_rad for segment in plan.segments}


def test_each_of_six_motions_begins_where_the_one_before_it_ended(direct: PickPlan) -> None:
    begin, end = starts(direct), ends(direct)
    assert list(end) == ["reach", "carry", "place", "home", "aside", "return"]
    for before, after in (("reach", "carry"), ("carry", "place"), ("place", "home")):
        assert np.array_equal(end[before], begin[after])
    for before, after in (("carry", "aside"), ("aside", "return"), ("return", "place")):
        assert np.array_equal(end[before], begin[after]), "with the look between hold and place, too"
    assert np.array_equal(begin["reach"], CAPTURE) and np.array_equal(end["home"], CAPTURE)


def test_it_is_held_above_where_it_is_laid_down(robot: Robot, direct: PickPlan) -> None:
    held, laid = (robot.base_from_tcp(ends(direct)[name]) for name in ("carry", "place"))
    assert held[:3, 3] == pytest.approx(laid[:3, 3] + (0, 0, LOWER_M), abs=1e-6)
    assert np.allclose(held[:3, :3], laid[:3, :3], atol=1e-6)


def test_the_look_is_taken_from_where_it_always_is(robot: Robot, scene: Scene, direct: PickPlan) -> None:
    past_the_viewpoint = plan_pick(scene, [GOOD], CAPTURE)
    assert np.array_equal(ends(direct)["aside"], ends(past_the_viewpoint)["carry"])


def test_without_the_detour_the_pick_is_shorter(scene: Scene, direct: PickPlan) -> None:
    detour = sum(part.trajectory.duration_s for part in plan_pick(scene, [GOOD], CAPTURE).segments)
    assert sum(part.trajectory.duration_s for part in direct.segments[:4]) < detour - 0.2


@pytest.mark.parametrize(("x", "y", "yaw"), [(0.41, -0.16, -0.8), (0.45, -0.1, -1.5), (0.44, 0.16, -1.8)])
def test_the_held_object_is_carried_steadily(robot: Robot, x: float, y: float, yaw: float) -> None:
    plan = plan_pick(Scene.of(robot, Station(nodes=NODES, verify=AUTO)), [grasp(x, y, 0.05, yaw)], CAPTURE)
    for segment in plan.segments:
        if segment.name in ("carry", "place", "aside", "return"):
            poses = [robot.base_from_tcp(q) for q in segment.trajectory.filtered()[::20]]
            assert max(pose[2, 2] for pose in poses) < -np.cos(np.radians(21.0)), "tool within 21 degrees of down"
            assert min(pose[2, 3] for pose in poses) > min(poses[0][2, 3], poses[-1][2, 3]) - 0.025


def test_it_goes_around_what_stands_between_place_and_tray(robot: Robot) -> None:
    """A post on the straight way; no motion with the object comes nearer than the clearance."""
    post = box("post", (0.42, 0.24, 0.2), (0.04, 0.04, 0.4))
    station = Station(nodes=NODES, verify=AUTO, scene=SceneSettings(obstacles=(post,)))
    around = plan_pick(Scene.of(robot, station), [GOOD], CAPTURE)
    judge = Scene.of(robot, station)
    for segment in around.segments:
        assert judge.gate(segment.trajectory.filtered(), GOOD.width_m if segment.name != "reach" else None) is None
    assert STATION.verify.look == "always", "what is not asked for stays as it was"
