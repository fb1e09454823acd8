"""Trajectories: at rest at both ends, as fast as the limits allow, and refused when they cannot be kept."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.codes import Code
from bus.errors import CycleFailure
from bus.trajectory import MAX_SAMPLES, Trajectory
from config.devices import ArmSettings
from config.limits import FR3, LOWER_RAD, UPPER_RAD, check, velocity_bounds
from config.pick import PlanningSettings
from config.schema import Station
from planning.arm import rest_to_rest_s
from planning.blend import Curve, blended
from planning.kinematics import FR3_ARM
from planning.line import tcp_line
from planning.robot import Robot
from planning.timing import rest_to_rest, timed, within_limits
from tests.planning.conftest import CAPTURE, NODES, STATION

TURNED = CAPTURE + np.array([0.8, 0.3, -0.4, 0.5, 0.6, -0.2, 1.2])


def test_a_move_joins_its_ends_within_every_limit_and_hardly_slower_than_possible() -> None:
    trajectory = rest_to_rest(STATION, CAPTURE, TURNED)
    q = trajectory.filtered()
    assert np.array_equal(q[0], CAPTURE)
    assert np.allclose(q[-1], TURNED, atol=1e-12)
    assert check(q).ok
    assert trajectory.duration_s < 1.05 * rest_to_rest_s(FR3, CAPTURE, TURNED) + 0.064
    along = (q - CAPTURE) @ (TURNED - CAPTURE) / ((TURNED - CAPTURE) @ (TURNED - CAPTURE))
    assert np.abs(q - CAPTURE - along[:, None] * (TURNED - CAPTURE)).max() < 1e-9, "a straight joint line"


def test_a_long_move_cruises_at_the_velocity_limit_of_its_slowest_joint() -> None:
    ends = np.stack([CAPTURE - np.array([1.2, 0, 0, 0, 0.2, 0, 0]), CAPTURE + np.array([1.2, 0, 0, 0, 0.2, 0, 0])])
    trajectory = timed(STATION, blended([ends]))
    assert trajectory.duration_s < 1.01 * rest_to_rest_s(FR3, ends[0], ends[1]) + 0.064
    assert 0.99 < check(trajectory.filtered()).velocity.ratio <= 1.0


@pytest.mark.parametrize("window_ms", [16, 64, 200])
def test_raw_samples_keep_velocity_and_acceleration_too(robot: Robot, window_ms: int) -> None:
    station = Station(nodes=NODES, planning=PlanningSettings(window_ms=window_ms))
    line = tcp_line(FR3_ARM, CAPTURE, robot.base_from_tcp(CAPTURE), np.array([0.1, 0.1, -0.3]))
    assert line is not None
    trajectory = timed(station, blended([line]))
    raw = check(trajectory.raw_q_rad)
    assert max(raw.velocity.ratio, raw.acceleration.ratio) <= 1.0
    assert check(trajectory.filtered()).ok


def test_a_timed_tcp_line_stays_straight(robot: Robot) -> None:
    shift = np.array([0.0, 0.0, -0.2])
    start = robot.base_from_tcp(CAPTURE)
    line = tcp_line(FR3_ARM, CAPTURE, start, shift)
    assert line is not None
    for q in timed(STATION, blended([line])).filtered()[::10]:
        assert np.abs(robot.base_from_tcp(q)[:2, 3] - start[:2, 3]).max() < 5e-4


def test_half_speed_takes_twice_as_long() -> None:
    ends = np.stack([CAPTURE, TURNED])
    slow = Station(nodes=NODES, arm=ArmSettings(speed=0.5))
    full_ticks, half_ticks = (len(timed(s, blended([ends])).raw_q_rad) - 1 for s in (STATION, slow))
    assert half_ticks == pytest.approx(2 * full_ticks, rel=0.02)


def test_near_the_position_limit_the_move_is_slower() -> None:
    near = CAPTURE.copy()
    near[0] = UPPER_RAD[0] - 0.01
    back = near - np.array([1.0, 0, 0, 0, 0, 0, 0])
    trajectory = timed(STATION, blended([np.stack([back, near])]))
    assert check(trajectory.filtered()).ok
    assert (
        trajectory.duration_s > 1.2 * timed(STATION, blended([np.stack([CAPTURE, CAPTURE + near - back])])).duration_s
    )


@pytest.mark.parametrize("distance_rad", [1e-12, 1e-7, 1e-5, 1e-4, 1e-2])
def test_tiny_moves_work(distance_rad: float) -> None:
    trajectory = rest_to_rest(STATION, CAPTURE, CAPTURE + distance_rad)
    assert check(trajectory.filtered()).ok
    assert np.allclose(trajectory.end_q_rad, CAPTURE + distance_rad, atol=1e-15)


def test_being_there_already_is_one_sample() -> None:
    assert len(rest_to_rest(STATION, CAPTURE, CAPTURE).raw_q_rad) == 1


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_not_finite_is_refused(bad: float) -> None:
    with pytest.raises(CycleFailure, match="not a finite number") as caught:
        rest_to_rest(STATION, CAPTURE, np.full(7, bad))
    assert caught.value.failure is Code.MOTION_REFUSED


def test_a_goal_outside_the_range_is_refused_by_joint() -> None:
    goal = CAPTURE.copy()
    goal[5] = UPPER_RAD[5] + 0.05
    with pytest.raises(CycleFailure, match="joint 6") as caught:
        rest_to_rest(STATION, CAPTURE, goal)
    assert caught.value.failure is Code.MOTION_REFUSED


def test_a_goal_where_no_velocity_is_left_is_refused() -> None:
    goal = CAPTURE.copy()
    goal[0] = UPPER_RAD[0] - 1e-6
    with pytest.raises(CycleFailure, match="velocity of joint 1"):
        timed(STATION, blended([np.stack([CAPTURE, goal])]))


def edge_rad(joint: int) -> float:
    """Where no speed towards the joint's upper limit is left, to a hundredth of a microradian."""
    low, high = CAPTURE[joint], UPPER_RAD[joint]
    while high - low > 1e-8:
        middle = (low + high) / 2
        upper = velocity_bounds(np.where(np.arange(7) == joint, middle, CAPTURE))[1][joint]
        low, high = (middle, high) if upper > 0 else (low, middle)
    return float(low)


def ended_at(joint: int, q_rad: float) -> np.ndarray:
    return np.where(np.arange(7) == joint, min(q_rad, UPPER_RAD[joint]), CAPTURE)


@settings(max_examples=20, deadline=None)
@given(
    st.integers(0, 6),
    st.sampled_from([-1e-2, -1e-3, -1e-6, 0.0, 1e-9, 1e-7, 1e-5, 1e-4, 1e-3, 1e-2, 0.05, 0.3]),
    st.sampled_from([1.0, 0.3]),
)
def test_to_a_limit_s_edge_a_move_is_timed_alike_or_refused(joint: int, before_rad: float, speed: float) -> None:
    station = Station(nodes=NODES, arm=ArmSettings(speed=speed))
    goal = ended_at(joint, edge_rad(joint) - before_rad)
    started_s = time.process_time()
    durations_s = []
    line = blended([np.stack([CAPTURE, goal])])
    make: Callable[[], Trajectory]
    for make in (lambda: rest_to_rest(station, CAPTURE, goal), lambda: timed(station, line)):
        try:
            durations_s.append(make().duration_s)
        except CycleFailure as failure:
            assert failure.failure is Code.MOTION_REFUSED and f"joint {joint + 1}" in failure.text
            durations_s.append(np.inf)
    assert time.process_time() - started_s < 3.0
    assert durations_s[0] == durations_s[1] == np.inf or durations_s[0] < 2 * durations_s[1] + 0.1
    assert before_rad < 1e-3 or durations_s[0] < 10.0 / speed


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(1e-9, 1 - 1e-9), min_size=14, max_size=14))
def test_anywhere_within_the_range_a_straight_line_is_hardly_slower_than_the_fastest(shares: list[float]) -> None:
    ends = LOWER_RAD + np.array(shares).reshape(2, 7) * (UPPER_RAD - LOWER_RAD)
    try:
        fastest = timed(STATION, blended([ends]))
    except CycleFailure as failure:
        assert failure.failure is Code.MOTION_REFUSED and "joint" in failure.text
        return
    line = rest_to_rest(STATION, *ends)
    assert check(line.filtered()).ok
    assert line.duration_s < 2 * fastest.duration_s + 0.1


def test_a_joint_that_rests_where_it_may_not_move_may_rest_there_and_leave() -> None:
    stuck = ended_at(2, edge_rad(2) + 1e-3)
    aside = np.where(np.arange(7) == 0, 0.5, stuck)
    assert check(rest_to_rest(STATION, stuck, aside).filtered()).ok
    assert check(rest_to_rest(STATION, stuck, CAPTURE).filtered()).ok
    with pytest.raises(CycleFailure, match=r"joint 3 would have to be 0 at 2\.89"):
        rest_to_rest(STATION, CAPTURE, stuck)


@pytest.mark.parametrize("duration_s", [0.5, 1e3, 1e9, float("inf"), float("nan")])
def test_however_wrong_a_profile_is_the_samples_made_of_it_are_bounded(duration_s: float) -> None:
    """It ends where joint 3 has almost no speed left, and gets there far too fast."""
    goal, made = ended_at(2, edge_rad(2) - 1e-8), []

    def sampler(times_s: np.ndarray) -> np.ndarray:
        made.append(len(times_s))
        q_rad: np.ndarray = CAPTURE + (times_s / duration_s)[:, None] * (goal - CAPTURE)
        return q_rad

    with pytest.raises(CycleFailure, match="cannot be timed"):
        within_limits(FR3, sampler, duration_s, (CAPTURE, goal), 64)
    assert max(made, default=0) <= MAX_SAMPLES and not sum(made) > 100 * duration_s * 1000


def test_the_same_path_is_timed_to_the_same_bits() -> None:
    one, other = (timed(STATION, blended([np.stack([CAPTURE, TURNED])])) for _ in range(2))
    assert np.array_equal(one.raw_q_rad, other.raw_q_rad)


def test_all_joints_of_a_rest_to_rest_move_are_in_phase() -> None:
    q = rest_to_rest(STATION, CAPTURE, TURNED).raw_q_rad
    shares = (q - CAPTURE) / (TURNED - CAPTURE)
    assert np.ptp(shares, axis=1).max() < 1e-9


def test_a_path_without_points_is_refused() -> None:
    empty = Curve(np.zeros(1), np.empty((0, 7)), ())
    with pytest.raises(CycleFailure, match="no points") as caught:
        timed(STATION, empty)
    assert caught.value.failure is Code.MOTION_REFUSED
