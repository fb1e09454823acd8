"""Planning a whole pick: what comes out, in which order, and why not."""

from __future__ import annotations

import numpy as np
import pytest

from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Grasp, PickPlan
from config.limits import UPPER_RAD
from config.schema import Box, NodeSettings, SceneSettings, Station, VerifySettings
from planning.pick import LOWER_M, plan_pick
from planning.robot import FINGER_TIP_M, Robot

NODES = {"sim": NodeSettings(driver="sim", serves=("camera", "arm", "hand"))}
STATION = Station(nodes=NODES)
CAPTURE = np.array(STATION.arm.capture_q_rad)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot(STATION)


def grasp(x: float, y: float, z: float, yaw: float = 0.0, tilt: float = 0.0) -> Grasp:
    """A grasp from above, turned by ``yaw`` about the vertical and then tilted about the closing axis."""
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    lean = np.array([[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn @ np.diag([1.0, -1.0, -1.0]) @ lean, (x, y, z)
    return Grasp(base_from_tcp=pose, width_m=0.04, opening_m=0.06, score=1.0, rectangle=0,
                 imagined_base_from_tcp=pose, terms={})  # fmt: skip


GOOD = grasp(0.45, 0.05, 0.05, yaw=0.6)
FAR = grasp(1.20, 0.0, 0.05)


def ends(plan: PickPlan) -> dict[str, np.ndarray]:
    return {segment.name: segment.trajectory.end_q_rad for segment in plan.segments}


@pytest.fixture(scope="module")
def plan(robot: Robot) -> PickPlan:
    return plan_pick(robot, STATION, [GOOD], CAPTURE)


def test_the_segments_follow_each_other_without_a_gap(plan: PickPlan) -> None:
    names = [s.name for s in plan.segments]
    assert names == ["transit", "approach", "lift", "view", "place", "lower", "retreat", "home"]
    assert np.array_equal(plan.segments[0].trajectory.start_q_rad, CAPTURE)
    for before, after in zip(plan.segments, plan.segments[1:], strict=False):
        assert np.array_equal(before.trajectory.end_q_rad, after.trajectory.start_q_rad)
    assert (plan.grasp, plan.rejected) == (0, ())


def test_the_tcp_goes_where_the_pick_needs_it(robot: Robot, plan: PickPlan) -> None:
    tcp = {name: robot.base_from_tcp(q) for name, q in ends(plan).items()}
    target = GOOD.base_from_tcp
    half_turn = target @ np.diag([-1.0, -1.0, 1.0, 1.0])
    assert min(np.abs(tcp["approach"] - t).max() for t in (target, half_turn)) < 1e-9
    assert np.allclose(tcp["transit"][:3, 3], target[:3, 3] - STATION.planning.approach_m * target[:3, 2], atol=1e-9)
    assert np.allclose(tcp["lift"][:3, 3], target[:3, 3] + [0, 0, STATION.planning.lift_m], atol=1e-9)
    assert np.allclose(tcp["lower"][:3, 3], STATION.scene.place_m, atol=1e-9)
    assert np.allclose(tcp["place"][:3, 3], np.array(STATION.scene.place_m) + np.array([0, 0, LOWER_M]), atol=1e-9)
    assert np.array_equal(ends(plan)["home"], CAPTURE)


def test_the_second_look_is_taken_from_aside_as_high_and_as_level_as_the_first(robot: Robot, plan: PickPlan) -> None:
    first, second = robot.base_from_color(CAPTURE), robot.base_from_color(ends(plan)["view"])
    aside_m = second[:2, 3] - GOOD.base_from_tcp[:2, 3]
    assert min(np.abs(aside_m - offset).max() for offset in STATION.verify.look_aside_m) < 1e-6
    assert np.allclose(second[:3, :3], first[:3, :3], atol=1e-6) and abs(second[2, 3] - first[2, 3]) < 1e-6


def test_without_a_reachable_place_aside_the_second_look_is_taken_from_the_capture_pose(robot: Robot) -> None:
    far = Station(nodes=NODES, verify=VerifySettings(look_aside_m=((3.0, 0.0),)))
    assert np.array_equal(ends(plan_pick(robot, far, [GOOD], CAPTURE))["view"], CAPTURE)


def test_a_tilted_grasp_keeps_the_objects_tilt_where_it_is_laid_down(robot: Robot) -> None:
    tilted = grasp(0.45, 0.0, 0.06, yaw=0.4, tilt=0.4)
    laid = robot.base_from_tcp(ends(plan_pick(robot, STATION, [tilted], CAPTURE))["lower"])
    assert np.allclose(laid[2, :3] ** 2, tilted.base_from_tcp[2, :3] ** 2, atol=1e-9), "only turned about the vertical"


@pytest.mark.parametrize(("x", "y", "yaw"), [(0.41, -0.16, -0.8), (0.45, -0.1, -1.5), (0.44, 0.16, -1.8)])
def test_the_held_object_is_carried_steadily_where_the_fastest_way_would_swing_it(
    robot: Robot, x: float, y: float, yaw: float
) -> None:
    steady = plan_pick(robot, STATION, [grasp(x, y, 0.05, yaw)], CAPTURE)
    for segment in steady.segments:
        if segment.name in ("view", "place"):
            poses = [robot.base_from_tcp(q) for q in segment.trajectory.filtered()[::20]]
            assert max(pose[2, 2] for pose in poses) < -np.cos(np.radians(21.0)), "tool within 21 degrees of down"
            assert min(pose[2, 3] for pose in poses) > min(poses[0][2, 3], poses[-1][2, 3]) - 0.025


def test_a_low_grasp_is_raised_until_the_finger_tips_clear_the_table(robot: Robot) -> None:
    low = plan_pick(robot, STATION, [grasp(0.45, 0.05, 0.004)], CAPTURE)
    tips_m = robot.base_from_tcp(ends(low)["approach"])[2, 3] - FINGER_TIP_M
    assert 0.002 <= tips_m <= 0.003


def test_a_grasp_inside_the_table_is_refused(robot: Robot) -> None:
    with pytest.raises(CycleFailure, match="fingers would touch table") as caught:
        plan_pick(robot, STATION, [grasp(0.45, 0.05, -0.02)], CAPTURE)
    assert caught.value.failure is Code.COLLISION


def test_the_first_feasible_grasp_wins_and_the_others_keep_their_reason(robot: Robot) -> None:
    chosen = plan_pick(robot, STATION, [FAR, grasp(0.45, 0.0, -0.05), GOOD, GOOD], CAPTURE)
    assert chosen.grasp == 2
    assert [(r.grasp, r.code) for r in chosen.rejected] == [(0, Code.UNREACHABLE), (1, Code.COLLISION)]
    assert all(r.reason for r in chosen.rejected)


def test_no_feasible_grasp_is_a_failure_with_counted_reasons(robot: Robot) -> None:
    with pytest.raises(CycleFailure, match="None of 2 grasps is feasible: 2 x no arm configuration") as caught:
        plan_pick(robot, STATION, [FAR, FAR], CAPTURE)
    assert caught.value.failure is Code.UNREACHABLE


def test_no_grasp_at_all_is_a_failure(robot: Robot) -> None:
    with pytest.raises(CycleFailure) as caught:
        plan_pick(robot, STATION, [], CAPTURE)
    assert caught.value.failure is Code.NO_GRASP


def test_an_obstacle_in_the_way_of_every_approach_is_named() -> None:
    lid = Box(name="lid", center_m=(0.45, 0.05, 0.12), size_m=(0.2, 0.2, 0.01))
    station = Station(nodes=NODES, scene=SceneSettings(obstacles=(lid,)))
    with pytest.raises(CycleFailure, match="touches lid") as caught:
        plan_pick(Robot(station), station, [GOOD], CAPTURE)
    assert caught.value.failure is Code.COLLISION


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_grasp_that_is_not_finite_is_rejected(robot: Robot, bad: float) -> None:
    pose = GOOD.base_from_tcp.copy()
    pose[0, 3] = bad
    chosen = plan_pick(robot, STATION, [GOOD.model_copy(update={"base_from_tcp": pose}), GOOD], CAPTURE)
    assert chosen.grasp == 1
    assert "finite" in chosen.rejected[0].reason


def test_a_grasp_whose_axes_are_mirrored_is_rejected(robot: Robot) -> None:
    mirrored = GOOD.model_copy(update={"base_from_tcp": GOOD.base_from_tcp @ np.diag([-1.0, 1.0, 1.0, 1.0])})
    assert "not a rotation" in plan_pick(robot, STATION, [mirrored, GOOD], CAPTURE).rejected[0].reason


def test_an_arm_that_stands_in_a_collision_cannot_start() -> None:
    block = Box(name="block", center_m=(0.375, 0.0, 0.6), size_m=(0.3, 0.3, 0.1))
    station = Station(nodes=NODES, scene=SceneSettings(obstacles=(block,)))
    with pytest.raises(CycleFailure, match=r"cannot start .* touches block") as caught:
        plan_pick(Robot(station), station, [GOOD], CAPTURE)
    assert caught.value.failure is Code.COLLISION


def test_an_arm_outside_its_limits_or_nowhere_cannot_start(robot: Robot) -> None:
    beyond = CAPTURE.copy()
    beyond[1] = UPPER_RAD[1] + 0.01
    for q, text in ((beyond, "joint 2 .* outside its range"), (CAPTURE * np.nan, "not finite")):
        with pytest.raises(CycleFailure, match=text) as caught:
            plan_pick(robot, STATION, [GOOD], q)
        assert caught.value.failure is Code.MOTION_REFUSED


def test_an_arm_that_waits_before_the_object_already_need_not_move(robot: Robot, plan: PickPlan) -> None:
    again = plan_pick(robot, STATION, [GOOD], ends(plan)["transit"])
    assert again.segments[0].trajectory.duration_s < 0.2


def test_same_inputs_give_the_same_bits(robot: Robot, plan: PickPlan) -> None:
    robot.collision(CAPTURE + 0.3)  # whatever it was asked before
    for model in (robot, Robot(STATION)):
        again = plan_pick(model, STATION, [GOOD], CAPTURE)
        assert again.model_dump_json() == plan.model_dump_json()
