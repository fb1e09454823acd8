"""An arm of six joints beside the FR3: examples/six_joint_arm, planned from its URDF alone."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from bus.errors import ConfigError
from bus.messages import Grasp
from config.load import load_station
from config.robot import limits_of, recorded_limits
from config.schema import Station
from planning.arm import limit_distance_rad
from planning.candidates import configurations, twins
from planning.line import tcp_line
from planning.links import Links
from planning.motion import move
from planning.pick import plan_pick
from planning.robot import Robot, flange_pose, part_name
from planning.scene import Scene
from planning.travel import Travel, lever_m

EXAMPLE = Path(__file__).parents[2] / "examples" / "six_joint_arm"
STATION = load_station(EXAMPLE / "station.toml")
CAPTURE = np.array(STATION.arm.capture_q_rad)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot(STATION)


def some(robot: Robot, count: int) -> np.ndarray:
    limits = robot.arm.limits
    return np.random.default_rng(5).uniform(0.8 * limits.lower_rad, 0.8 * limits.upper_rad, (count, 6))


def test_every_solution_reaches_the_pose_and_the_one_it_was_made_from_is_among_them(robot: Robot) -> None:
    found = 0
    for q_rad in some(robot, 20):
        pose = robot.base_from_flange(q_rad)
        solutions, owner = robot.arm.solutions(pose[None], 0.0)
        assert not owner.any()
        for solution in solutions:
            np.testing.assert_allclose(robot.base_from_flange(solution), pose, atol=1e-7)
        found += bool(np.abs(solutions - q_rad).max(axis=1).min(initial=9.0) < 1e-4)
    assert found >= 19


def test_the_same_pose_has_the_same_solutions_to_the_last_bit(robot: Robot) -> None:
    pose = robot.base_from_flange(CAPTURE)[None]
    one, other = (Robot(STATION).arm.solutions(pose, 0.08)[0] for _ in range(2))
    assert len(one) and np.array_equal(one, other)


def test_a_pose_out_of_reach_has_none(robot: Robot) -> None:
    far = np.eye(4)
    far[:3, 3] = 2.0, 0.0, 0.3
    assert list(configurations(robot.arm, twins(far), CAPTURE)) == []


def test_the_tcp_keeps_to_a_line_and_does_not_turn(robot: Robot) -> None:
    start = robot.base_from_tcp(CAPTURE)
    line = tcp_line(robot.arm, CAPTURE, start, np.array([0.0, 0.05, -0.3]))
    assert line is not None and limit_distance_rad(robot.arm.limits, line).min() > 0
    for share, q_rad in zip(np.linspace(0.0, 1.0, len(line)), line, strict=True):
        pose = robot.base_from_tcp(q_rad)
        np.testing.assert_allclose(pose[:3, 3], start[:3, 3] + share * np.array([0.0, 0.05, -0.3]), atol=1e-6)
        np.testing.assert_allclose(pose[:3, :3], start[:3, :3], atol=1e-6)
    assert tcp_line(robot.arm, CAPTURE, start, np.array([1.0, 0.0, 0.0])) is None


def test_what_is_not_checked_is_mounted_together_or_adjacent(robot: Robot) -> None:
    parts = sorted({part_name(part.name) for part in robot.meshes})
    hand = {"link 6", "hand", "camera", "left finger", "right finger"}
    assert set(parts) == {*hand, *(f"link {number}" for number in range(7))}
    checked = Scene.of(robot, STATION)._planned.own_pairs()
    left_out = {frozenset(pair) for pair in combinations(parts, 2)} - checked
    chain = {frozenset((f"link {number}", f"link {number + 1}")) for number in range(6)}
    assert left_out == chain | {frozenset(pair) for pair in combinations(sorted(hand), 2)}


def test_no_point_moves_farther_than_the_levers_and_the_travel_say(robot: Robot) -> None:
    travel, levers_m = Travel(robot, None), lever_m(robot)
    for start, end in zip(some(robot, 8), some(robot, 16)[8:], strict=True):
        bound_m = travel.along(start, end)[-1]
        assert np.linalg.norm(robot.base_from_tcp(end)[:3, 3] - robot.base_from_tcp(start)[:3, 3]) <= bound_m
        assert bound_m <= np.abs(end - start) @ levers_m * 1.5


def test_its_frames_lead_from_the_base_to_hand_and_camera(robot: Robot) -> None:
    poses = Links(robot).at(CAPTURE, 0.04)
    parents, base_from_hand, name = {child: parent for parent, child in poses}, np.eye(4), "fr3_hand"
    while name != "base":
        base_from_hand, name = poses[parents[name], name] @ base_from_hand, parents[name]
    np.testing.assert_allclose(base_from_hand, robot.base_from_hand(CAPTURE), atol=1e-12)


def test_a_pick_is_planned_within_its_limits(robot: Robot) -> None:
    """A grasp from above, 20 mm above the table."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = 0.5, 0.05, 0.02
    grasp = Grasp(
        base_from_tcp=pose, width_m=0.03, opening_m=0.05, score=0.9, rectangle=0, imagined_base_from_tcp=pose, terms={}
    )
    plan = plan_pick(Scene.of(robot, STATION), [grasp], CAPTURE)
    limits = limits_of(STATION)
    assert {len(segment.trajectory.end_q_rad) for segment in plan.segments} == {6}
    assert all(limits.check(segment.trajectory.filtered()).ok for segment in plan.segments)


# --- its station ------------------------------------------------------------------------------------------------------


def test_its_limits_are_the_station_s_and_a_recorded_station_s() -> None:
    limits = limits_of(STATION)
    assert limits.joints == 6 and limits.velocity_bounds(np.zeros((4, 6)))[1].shape == (4, 6)
    assert np.array_equal(recorded_limits(STATION.model_dump(mode="json")).upper_rad, limits.upper_rad)
    assert recorded_limits(Station(nodes=STATION.nodes).model_dump(mode="json")).joints == 7


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("arm.capture_q_rad=[0, 0, 0, 0, 0, 0, 0.1]", "has 7 numbers, and the arm 6 joints"),
        ("arm.capture_q_rad=[0, 0, 0, 0, 0, 3.12]", "joint 6 at 3.120 rad is outside its range"),
        ("arm.capture_q_rad=[0, 0, 0]", "arm.capture_q_rad"),
    ],
)
def test_a_capture_pose_that_it_cannot_have_is_refused(override: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        load_station(EXAMPLE / "station.toml", [override])


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (('"link3"', '"forearm"'), "'joint3' of .* does not turn link3 on link2"),
        (('name="joint4"', 'name="elbow"'), "has no joint 'joint4'"),
        (('axis xyz="0 0 1"', 'axis xyz="0 1 0"'), "'joint1' of .* does not turn about z"),
        (('name="joint2" type="revolute"', 'name="joint2" type="continuous"'), "'joint2' of .* does not turn"),
        (('axis xyz="0 0 1"', 'axis xyz="up"'), "'joint1' of .* does not turn about z"),
        (('"flange"', '"plate"'), "has no link 'flange'"),
        (('<parent link="link6"/>', '<parent link="link0"/>'), "has no link 'flange' fixed to link6"),
        (("</robot>", ""), "cannot be read"),
    ],
)
def test_a_urdf_that_cannot_be_used_is_refused_with_what_is_missing(
    tmp_path: Path, wrong: tuple[str, str], said: str
) -> None:
    urdf = tmp_path / "arm.urdf"
    urdf.write_text((EXAMPLE / "arm.urdf").read_text().replace(*wrong))
    with pytest.raises(ConfigError, match=said):
        Robot(load_station(EXAMPLE / "station.toml", [f"robot.urdf={urdf}"]))


def test_an_axis_may_be_written_with_decimals(tmp_path: Path) -> None:
    urdf = tmp_path / "arm.urdf"
    urdf.write_text((EXAMPLE / "arm.urdf").read_text().replace('axis xyz="0 0 1"', 'axis xyz="0.0 0.0 1.0"'))
    assert Robot(load_station(EXAMPLE / "station.toml", [f"robot.urdf={urdf}"])).base_from_tcp(CAPTURE).shape == (4, 4)


def test_the_flange_carries_the_hand_as_planning_has_it(robot: Robot) -> None:
    pose = robot.base_from_tcp(CAPTURE)
    np.testing.assert_allclose(flange_pose(pose), robot.base_from_flange(CAPTURE), atol=1e-9)
    assert len(move(Scene.of(robot, STATION), CAPTURE, CAPTURE + 0.2).end_q_rad) == 6
