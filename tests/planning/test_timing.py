"""Trajectories: at rest at both ends, as fast as the limits allow, and refused when they cannot be kept."""

from __future__ import annotations

import numpy as np
import pytest

from bus.codes import Code
from bus.errors import CycleFailure
from config.limits import UPPER_RAD, check
from config.schema import ArmSettings, PlanningSettings, Station
from planning.blend import Curve, blended
from planning.kinematics import rest_to_rest_s
from planning.line import tcp_line
from planning.robot import Robot
from planning.timing import hold, rest_to_rest, timed
from tests.planning.conftest import CAPTURE, NODES, STATION

TURNED = CAPTURE + np.array([0.8, 0.3, -0.4, 0.5, 0.6, -0.2, 1.2])


def test_a_move_joins_its_ends_within_every_limit_and_hardly_slower_than_possible() -> None:
    trajectory = rest_to_rest(STATION, CAPTURE, TURNED)
    q = trajectory.filtered()
    assert np.array_equal(q[0], CAPTURE)
    assert np.allclose(q[-1], TURNED, atol=1e-12)
    assert check(q).ok
    assert trajectory.duration_s < 1.05 * rest_to_rest_s(CAPTURE, TURNED) + 0.064
    along = (q - CAPTURE) @ (TURNED - CAPTURE) / ((TURNED - CAPTURE) @ (TURNED - CAPTURE))
    assert np.abs(q - CAPTURE - along[:, None] * (TURNED - CAPTURE)).max() < 1e-9, "a straight joint line"


def test_a_long_move_cruises_at_the_velocity_limit_of_its_slowest_joint() -> None:
    ends = np.stack([CAPTURE - np.array([1.2, 0, 0, 0, 0.2, 0, 0]), CAPTURE + np.array([1.2, 0, 0, 0, 0.2, 0, 0])])
    trajectory = timed(STATION, blended([ends]))
    assert trajectory.duration_s < 1.01 * rest_to_rest_s(ends[0], ends[1]) + 0.064
    assert 0.99 < check(trajectory.filtered()).velocity.ratio <= 1.0


@pytest.mark.parametrize("window_ms", [16, 64, 200])
def test_raw_samples_keep_velocity_and_acceleration_too(robot: Robot, window_ms: int) -> None:
    station = Station(nodes=NODES, planning=PlanningSettings(window_ms=window_ms))
    line = tcp_line(CAPTURE, robot.base_from_tcp(CAPTURE), np.array([0.1, 0.1, -0.3]))
    assert line is not None
    trajectory = timed(station, blended([line]))
    raw = check(trajectory.raw_q_rad)
    assert max(raw.velocity.ratio, raw.acceleration.ratio) <= 1.0
    assert check(trajectory.filtered()).ok


def test_a_timed_tcp_line_stays_straight(robot: Robot) -> None:
    shift = np.array([0.0, 0.0, -0.2])
    start = robot.base_from_tcp(CAPTURE)
    line = tcp_line(CAPTURE, start, shift)
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


def test_hold_stays_for_its_time() -> None:
    trajectory = hold(CAPTURE, 3.0)
    assert trajectory.duration_s == pytest.approx(3.0)
    assert (trajectory.filtered() == CAPTURE).all()
    assert len(hold(CAPTURE, 0.0).raw_q_rad) == 1


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
