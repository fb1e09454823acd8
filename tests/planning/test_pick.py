"""Planning a whole pick: what comes out, in which order, and why not."""

from __future__ import annotations

import numpy as np
import pytest

from bus.codes import PLACE_OUT_OF_REACH, PLACE_TAKEN, Code
from bus.errors import CycleFailure
from bus.messages import Grasp, PickPlan
from config.franka_hand import FINGER_TIP_M
from config.limits import UPPER_RAD
from config.pick import PlanningSettings, VerifySettings
from config.scene import Box, SceneSettings, scene_boxes
from config.schema import Station
from planning.height_field import Sight
from planning.pick import plan_pick
from planning.pregrasp import LOWER_M
from planning.robot import CAMERA_SIZE_M, Robot
from planning.scene import Scene
from tests.planning.conftest import CAPTURE, NODES, STATION, WIDE_M, among, box
from tests.planning.views import seen_from_above


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


def passes(robot: Robot, plan: PickPlan, name: str, position_m: np.ndarray) -> float:
    """How near the tcp comes to a position during one motion [m]."""
    (segment,) = (segment for segment in plan.segments if segment.name == name)
    tcp = np.stack([robot.base_from_tcp(q)[:3, 3] for q in segment.trajectory.filtered()[::5]])
    return float(np.linalg.norm(tcp - position_m, axis=1).min())


@pytest.fixture(scope="module")
def plan(scene: Scene) -> PickPlan:
    return plan_pick(scene, [GOOD], CAPTURE)


def test_four_motions_follow_each_other_without_a_gap(plan: PickPlan) -> None:
    assert [s.name for s in plan.segments] == ["reach", "carry", "place", "home"]
    assert np.array_equal(plan.segments[0].trajectory.start_q_rad, CAPTURE)
    for before, after in zip(plan.segments, plan.segments[1:], strict=False):
        assert np.array_equal(before.trajectory.end_q_rad, after.trajectory.start_q_rad)
    assert (plan.grasp, plan.tilt_rad, plan.rejected) == (0, 0.0, ())
    assert {s.route for s in plan.segments} == {"straight"}


def test_the_tcp_goes_where_the_pick_needs_it(robot: Robot, plan: PickPlan) -> None:
    tcp = {name: robot.base_from_tcp(q) for name, q in ends(plan).items()}
    target = GOOD.base_from_tcp
    half_turn = target @ np.diag([-1.0, -1.0, 1.0, 1.0])
    assert min(np.abs(tcp["reach"] - t).max() for t in (target, half_turn)) < 1e-9
    assert np.allclose(tcp["place"][:3, 3], STATION.scene.place_m, atol=1e-9)
    assert np.array_equal(ends(plan)["home"], CAPTURE)
    above = np.array(STATION.scene.place_m) + np.array([0, 0, LOWER_M])
    assert passes(robot, plan, "place", above) < 0.03, "the corner is rounded"
    assert passes(robot, plan, "home", above) < 0.03


@pytest.mark.parametrize("yaw", [0.6, 0.6 + np.pi])
def test_what_is_held_hangs_as_it_was_grasped_also_by_the_grasp_turned_by_half_a_turn(
    robot: Robot, yaw: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = box("target", (0.45, 0.05, 0.03), (0.04, 0.1, 0.06))
    view = seen_from_above((STATION.scene.table,), eye_m=(0.45, 0.0, 1.2), target=target)
    scene = Scene.of(robot, STATION, Sight(*view))
    held_at: list[np.ndarray] = []
    holding = Scene.holding

    def noted(scene: Scene, pose: np.ndarray) -> Scene:
        held_at.append(pose)
        return holding(scene, pose)

    monkeypatch.setattr(Scene, "holding", noted)
    plan = plan_pick(scene, [grasp(0.45, 0.05, 0.05, yaw=yaw)], CAPTURE)
    assert held_at and np.allclose(held_at[-1], robot.base_from_tcp(ends(plan)["reach"]), atol=1e-9)


@pytest.mark.parametrize("height_m", [0.03, 0.08, 0.15, 0.19])
def test_what_hangs_far_below_the_hand_is_released_higher(robot: Robot, scene: Scene, height_m: float) -> None:
    """Its foot stood on the table, ``height_m`` below the tcp; just above the tray it is released, and no lower."""
    tray = STATION.scene.tray
    tray_m, clearance_m = tray.center_m[2] + tray.size_m[2] / 2, STATION.planning.clearance_m
    released = robot.base_from_tcp(ends(plan_pick(scene, [grasp(0.45, 0.05, height_m)], CAPTURE))["place"])
    x, y, z = STATION.scene.place_m
    foot_m = released[2, 3] - height_m
    assert released[:2, 3] == pytest.approx((x, y), abs=1e-6) and foot_m > tray_m
    if z - height_m > tray_m + clearance_m + 0.005:
        assert released[2, 3] == pytest.approx(z, abs=1e-6)
    else:
        assert foot_m == pytest.approx(tray_m + clearance_m, abs=0.006), "not dropped from high above either"


def test_the_hand_comes_straight_down_and_goes_straight_up(robot: Robot, plan: PickPlan) -> None:
    for name, share in (("reach", 0.3), ("carry", 0.3)):
        (segment,) = (segment for segment in plan.segments if segment.name == name)
        tcp = np.stack([robot.base_from_tcp(q)[:3, 3] for q in segment.trajectory.filtered()])
        length_m = STATION.planning.approach_m if name == "reach" else STATION.planning.lift_m
        low = tcp[tcp[:, 2] < GOOD.base_from_tcp[2, 3] + share * length_m]
        assert len(low) > 20
        assert np.hypot(*(low[:, :2] - GOOD.base_from_tcp[:2, 3]).T).max() < 1e-3


def test_the_second_look_is_taken_from_aside_as_high_and_as_level_as_the_first(robot: Robot, plan: PickPlan) -> None:
    first, second = robot.base_from_color(CAPTURE), robot.base_from_color(ends(plan)["carry"])
    aside_m = second[:2, 3] - GOOD.base_from_tcp[:2, 3]
    assert min(np.abs(aside_m - offset).max() for offset in STATION.verify.look_aside_m) < 1e-6
    assert np.allclose(second[:3, :3], first[:3, :3], atol=1e-6) and abs(second[2, 3] - first[2, 3]) < 1e-6


def test_without_a_reachable_place_aside_the_second_look_is_taken_from_the_capture_pose(robot: Robot) -> None:
    far = Station(nodes=NODES, verify=VerifySettings(look_aside_m=((3.0, 0.0),)))
    assert np.array_equal(ends(plan_pick(Scene.of(robot, far), [GOOD], CAPTURE))["carry"], CAPTURE)


def test_a_tilted_grasp_keeps_the_objects_tilt_where_it_is_laid_down(robot: Robot, scene: Scene) -> None:
    tilted = grasp(0.45, 0.0, 0.06, yaw=0.4, tilt=0.4)
    laid = robot.base_from_tcp(ends(plan_pick(scene, [tilted], CAPTURE))["place"])
    assert np.allclose(laid[2, :3] ** 2, tilted.base_from_tcp[2, :3] ** 2, atol=1e-9), "only turned about the vertical"


@pytest.mark.parametrize(("x", "y", "yaw"), [(0.41, -0.16, -0.8), (0.45, -0.1, -1.5), (0.44, 0.16, -1.8)])
def test_the_held_object_is_carried_steadily_where_the_fastest_way_would_swing_it(
    robot: Robot, scene: Scene, x: float, y: float, yaw: float
) -> None:
    keeps_level = plan_pick(scene, [grasp(x, y, 0.05, yaw)], CAPTURE)
    for segment in keeps_level.segments:
        if segment.name in ("carry", "place"):
            poses = [robot.base_from_tcp(q) for q in segment.trajectory.filtered()[::20]]
            assert max(pose[2, 2] for pose in poses) < -np.cos(np.radians(21.0)), "tool within 21 degrees of down"
            assert min(pose[2, 3] for pose in poses) > min(poses[0][2, 3], poses[-1][2, 3]) - 0.025


HAND_M, HOUSING_M = np.array([[-0.028, -0.09, 0.005], [0.028, 0.09, 0.06]]), np.array(CAMERA_SIZE_M) / 2
"""A box inside the hand, whose corners are round; half the camera's housing."""


@pytest.mark.parametrize("tilt", [1.3, -1.3])
@pytest.mark.parametrize(("z", "yaw"), [(0.02, 0.5), (0.05, np.pi / 2), (0.12, 0.5)])
def test_from_the_side_hand_and_camera_stay_off_the_table(
    robot: Robot, scene: Scene, z: float, yaw: float, tilt: float
) -> None:
    aside = plan_pick(scene, [grasp(0.46, 0.0, z, yaw, tilt)], CAPTURE)
    reach = aside.segments[0].trajectory.filtered()
    approach = robot.base_from_tcp(reach[-1])[:3, 2]
    assert np.degrees(np.arccos(-approach[2])) > 55, "it comes from the side"
    for q in reach[len(reach) // 2 :: 20]:
        hand, camera = robot.base_from_hand(q), robot.base_from_color(q)
        hand_m = [(hand @ [x, y, z, 1.0])[2] for x in HAND_M[:, 0] for y in HAND_M[:, 1] for z in HAND_M[:, 2]]
        reach_m = np.abs(camera[2, :3]) @ HOUSING_M  # of the housing, up and down from its middle
        middle_m = (camera @ [0.0, 0.0, 0.005 - HOUSING_M[2], 1.0])[2]
        assert min(*hand_m, middle_m - reach_m) > 0.0


def test_a_side_grasp_that_would_put_the_camera_into_the_table_leans_more_steeply(scene: Scene) -> None:
    low = plan_pick(scene, [grasp(0.46, 0.0, 0.02, 0.0, 1.3)], CAPTURE)
    assert low.tilt_rad != 0.0 and "camera touches table" in low.rejected[0].reason


def test_a_low_grasp_is_raised_until_the_finger_tips_clear_the_table(robot: Robot, scene: Scene) -> None:
    low = plan_pick(scene, [grasp(0.45, 0.05, 0.004)], CAPTURE)
    tips_m = robot.base_from_tcp(ends(low)["reach"])[2, 3] - FINGER_TIP_M
    assert 0.002 <= tips_m <= 0.003


def test_a_grasp_inside_the_table_is_refused(scene: Scene) -> None:
    with pytest.raises(CycleFailure, match="fingers would touch table") as caught:
        plan_pick(scene, [grasp(0.45, 0.05, -0.02)], CAPTURE)
    assert caught.value.failure is Code.COLLISION


def test_the_first_feasible_grasp_wins_and_the_others_keep_their_reason(scene: Scene) -> None:
    chosen = plan_pick(scene, [FAR, grasp(0.45, 0.0, -0.05), GOOD, GOOD], CAPTURE)
    assert chosen.grasp == 2
    assert [(r.grasp, r.code) for r in chosen.rejected] == [(0, Code.UNREACHABLE), (1, Code.COLLISION)]
    assert all(r.reason for r in chosen.rejected)


def test_a_grasp_like_one_that_missed_is_left_out_whichever_way_round_the_hand_is(scene: Scene) -> None:
    turned = GOOD.base_from_tcp @ np.diag([-1.0, -1.0, 1.0, 1.0])
    aside = grasp(0.45, 0.09, 0.05)
    chosen = plan_pick(scene, [GOOD, aside], CAPTURE, missed=[turned])
    assert chosen.grasp == 1 and (chosen.rejected[0].grasp, chosen.rejected[0].code) == (0, Code.GRASP_MISSED)
    with pytest.raises(CycleFailure, match="one that failed before") as caught:
        plan_pick(scene, [GOOD], CAPTURE, missed=[turned])
    assert caught.value.failure is Code.NO_GRASP


def test_no_feasible_grasp_is_a_failure_with_counted_reasons(scene: Scene) -> None:
    with pytest.raises(
        CycleFailure, match="None of 10 ways to grasp is feasible: 10 x unreachable: no arm configuration"
    ) as caught:
        plan_pick(scene, [FAR, FAR], CAPTURE)
    assert caught.value.failure is Code.UNREACHABLE
    assert sorted(one.grasp for one in caught.value.rejected) == 5 * [0] + 5 * [1]
    assert {one.code for one in caught.value.rejected} == {Code.UNREACHABLE}


def test_a_place_out_of_reach_is_named_and_the_object_is_not_blamed(robot: Robot) -> None:
    station = Station(nodes=NODES, scene=SceneSettings(place_m=(0.46, 0.45, 0.8)))
    with pytest.raises(CycleFailure, match=r"5 x the place \(0.46, 0.45, 0.80\) cannot be reached") as caught:
        plan_pick(Scene.of(robot, station), [GOOD], CAPTURE)
    assert caught.value.failure is Code.UNREACHABLE
    assert caught.value.advice == PLACE_OUT_OF_REACH


def _released_m(robot: Robot, place: SceneSettings, *taken: Box) -> np.ndarray:
    """Where a cube is let go among things that stand in the tray, over the place [m]."""
    station = STATION.model_copy(update={"scene": place})
    target = box("target", (0.45, 0.05, 0.03), (0.04, 0.04, 0.06))
    sight = Sight(*seen_from_above((place.table,), eye_m=(0.45, 0.0, 1.2), target=target))
    scene = Scene.of(robot, station, sight, boxes=(*scene_boxes(place), *taken))
    released_m = robot.base_from_tcp(ends(plan_pick(scene, [grasp(0.45, 0.05, 0.05)], CAPTURE))["place"])[:3, 3]
    return np.asarray(released_m - place.place_m)


def test_where_a_place_is_taken_the_next_of_its_pattern_is_used(robot: Robot) -> None:
    x, y, _ = STATION.scene.place_m
    two = STATION.scene.model_copy(update={"place_pattern_m": ((0.0, 0.0), (-0.12, 0.0))})
    taken = box("jar", (x, y, 0.12), (0.06, 0.06, 0.24))
    assert _released_m(robot, two) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    assert _released_m(robot, two, taken) == pytest.approx((-0.12, 0.0, 0.0), abs=1e-6)


def test_where_all_are_taken_it_goes_on_top_or_the_advice_says_to_empty_the_tray(robot: Robot) -> None:
    x, y, z = STATION.scene.place_m
    taken = box("jar", (x, y, z / 2 - 0.01), (0.30, 0.30, z - 0.02))
    with pytest.raises(CycleFailure, match="touches held object") as caught:
        _released_m(robot, STATION.scene, taken)
    assert (caught.value.failure, caught.value.advice) == (Code.COLLISION, PLACE_TAKEN)
    higher = STATION.scene.model_copy(update={"place_higher_m": 0.10})
    assert _released_m(robot, higher, taken) == pytest.approx((0.0, 0.0, 0.05), abs=1e-6)
    assert _released_m(robot, higher) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6), "not where there is room"


def test_no_grasp_at_all_is_a_failure(scene: Scene) -> None:
    with pytest.raises(CycleFailure) as caught:
        plan_pick(scene, [], CAPTURE)
    assert caught.value.failure is Code.NO_GRASP


def test_an_obstacle_in_the_way_of_every_approach_is_named(robot: Robot) -> None:
    lid = box("lid", (0.45, 0.05, 0.12), (0.2, 0.2, 0.01))
    with pytest.raises(CycleFailure, match="touches lid") as caught:
        plan_pick(among(robot, lid), [GOOD], CAPTURE)
    assert caught.value.failure is Code.COLLISION


def test_after_its_budget_no_further_way_is_tried_and_it_says_how_many_are_left(robot: Robot) -> None:
    lid, hurried = box("lid", (0.45, 0.05, 0.12), (0.2, 0.2, 0.01)), PlanningSettings(budget_s=0.001)
    station = Station(nodes=NODES, scene=SceneSettings(obstacles=(lid,)), planning=hurried)
    texts = []
    for _ in range(2):
        with pytest.raises(CycleFailure, match=r"None of 1 ways .* 4 more were not tried: planning.budget_s") as caught:
            plan_pick(Scene.of(robot, station), [GOOD], CAPTURE)
        texts.append(caught.value.text)
    assert texts[0] == texts[1]


def test_beside_a_wall_it_comes_from_the_free_side(robot: Robot) -> None:
    across = grasp(0.45, 0.05, 0.05)  # closes along y: the palm is long along y, tilts lean it along x
    wall = box("wall", (0.49, 0.05, 0.2), (0.02, 0.3, 0.4))
    leaning = plan_pick(among(robot, wall), [across], CAPTURE)
    assert leaning.tilt_rad != 0.0
    assert "touches wall" in leaning.rejected[0].reason
    assert robot.base_from_hand(ends(leaning)["reach"])[0, 3] < 0.45, "the hand is on the side away from the wall"


def test_too_wide_for_the_jaw_is_a_reason(scene: Scene) -> None:
    wide = GOOD.model_copy(update={"width_m": 0.085})
    chosen = plan_pick(scene, [wide, GOOD], CAPTURE)
    assert chosen.grasp == 1
    assert (chosen.rejected[0].code, chosen.rejected[0].reason[:6]) == (Code.NO_GRASP, "width:")


def test_a_post_in_the_straight_way_is_gone_around(robot: Robot, plan: PickPlan) -> None:
    middle = plan.segments[2].trajectory.raw_q_rad
    tcp = robot.base_from_tcp(middle[int(0.6 * len(middle))])[:3, 3]
    crowded = among(robot, box("post", (tcp[0], tcp[1], 0.35), (0.04, 0.04, 0.7)))
    around = plan_pick(crowded, [GOOD], CAPTURE)
    assert "searched" in {segment.route for segment in around.segments}
    for segment in around.segments:
        assert crowded.gate(segment.trajectory.filtered(), WIDE_M) is None


def test_what_is_only_seen_is_kept_away_from_by_the_true_boxes(robot: Robot) -> None:
    target = box("target", (0.45, 0.05, 0.04), (0.05, 0.04, 0.08))
    beside = (box("left", (0.45, 0.132, 0.03), (0.06, 0.04, 0.06)), box("tall", (0.60, 0.0, 0.15), (0.05, 0.05, 0.30)))
    view = seen_from_above((STATION.scene.table, *beside), eye_m=(0.45, 0.0, 1.2), target=target, noise_m=0.001)
    chosen = plan_pick(Scene.of(robot, STATION, Sight(*view)), [grasp(0.45, 0.05, 0.05)], CAPTURE)
    truth = among(robot, *beside)
    widths_m = {"reach": 0.06, "home": None}
    for segment in chosen.segments:
        assert truth.gate(segment.trajectory.filtered(), widths_m.get(segment.name, 0.04)) is None, segment.name


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_grasp_that_is_not_finite_is_rejected(scene: Scene, bad: float) -> None:
    pose = GOOD.base_from_tcp.copy()
    pose[0, 3] = bad
    chosen = plan_pick(scene, [GOOD.model_copy(update={"base_from_tcp": pose}), GOOD], CAPTURE)
    assert chosen.grasp == 1
    assert "finite" in chosen.rejected[0].reason


def test_a_grasp_whose_axes_are_mirrored_is_rejected(scene: Scene) -> None:
    mirrored = GOOD.model_copy(update={"base_from_tcp": GOOD.base_from_tcp @ np.diag([-1.0, 1.0, 1.0, 1.0])})
    assert "not a rotation" in plan_pick(scene, [mirrored, GOOD], CAPTURE).rejected[0].reason


def test_an_arm_that_stands_in_a_collision_cannot_start(robot: Robot) -> None:
    block = box("block", (0.375, 0.0, 0.6), (0.3, 0.3, 0.1))
    with pytest.raises(CycleFailure, match=r"cannot start .* touches block") as caught:
        plan_pick(among(robot, block), [GOOD], CAPTURE)
    assert caught.value.failure is Code.COLLISION


def test_an_arm_outside_its_limits_or_nowhere_cannot_start(scene: Scene) -> None:
    beyond = CAPTURE.copy()
    beyond[1] = UPPER_RAD[1] + 0.01
    for q, text in ((beyond, "joint 2 .* outside its range"), (CAPTURE * np.nan, "not finite")):
        with pytest.raises(CycleFailure, match=text) as caught:
            plan_pick(scene, [GOOD], q)
        assert caught.value.failure is Code.MOTION_REFUSED


def test_it_starts_from_wherever_the_arm_is(scene: Scene) -> None:
    elsewhere = CAPTURE + np.array([0.7, 0.2, -0.2, 0.3, 0.2, 0.3, 0.5])
    again = plan_pick(scene, [GOOD], elsewhere)
    assert np.array_equal(again.segments[0].trajectory.start_q_rad, elsewhere)
    assert np.array_equal(ends(again)["home"], CAPTURE)


def test_same_inputs_give_the_same_bits(scene: Scene, plan: PickPlan) -> None:
    scene.collision(CAPTURE + 0.3, WIDE_M)  # whatever it was asked before
    for anew in (scene, Scene.of(Robot(STATION), STATION)):
        assert plan_pick(anew, [GOOD], CAPTURE).model_dump_json() == plan.model_dump_json()


def test_what_is_held_is_accelerated_no_more_than_it_may_be_and_the_empty_hand_as_ever(robot: Robot) -> None:
    unbound = STATION.planning.model_copy(update={"max_held_acceleration_m_s2": None})
    any_pace = STATION.model_copy(update={"planning": unbound})
    calm = STATION.model_copy(
        update={"planning": STATION.planning.model_copy(update={"max_held_acceleration_m_s2": 3.0})}
    )
    fast, slow = (plan_pick(Scene.of(robot, station), [GOOD], CAPTURE) for station in (any_pace, calm))
    assert _peak_m_s2(robot, fast, "carry") > 4.0
    for name in ("carry", "place"):
        assert _peak_m_s2(robot, slow, name) < 1.1 * 3.0
    for name in ("reach", "home"):
        assert _peak_m_s2(robot, slow, name) == _peak_m_s2(robot, fast, name)


def _peak_m_s2(robot: Robot, plan: PickPlan, name: str) -> float:
    (segment,) = (segment for segment in plan.segments if segment.name == name)
    tcp_m = np.stack([robot.base_from_tcp(q)[:3, 3] for q in segment.trajectory.filtered()[::4]])
    return float(np.linalg.norm(np.diff(tcp_m, 2, axis=0), axis=1).max() / 0.004**2)
