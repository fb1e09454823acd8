"""What a felt approach needs: a slow end, a bound for closing early, a way on, and a way back."""

from __future__ import annotations

import numpy as np
import pytest

from bus.arrays import Joints, JointSamples
from bus.trajectory import Trajectory
from config.franka_hand import FINGER_TIP_M
from config.limits import check
from config.load import load_station
from planning.blend import blended
from planning.feeling import closes_within_m, guard, joined, way_back
from planning.kinematics import FR3_ARM
from planning.line import tcp_line
from planning.robot import Robot
from planning.scene import Scene
from planning.slow_end import slow_end
from planning.timing import timed

STATION = load_station()
ROBOT = Robot(STATION)
SETTINGS = STATION.execute
ABOVE_RAD = np.array(STATION.arm.capture_q_rad)


def line(down_m: float, q_rad: np.ndarray = ABOVE_RAD) -> JointSamples:
    points = tcp_line(FR3_ARM, q_rad, ROBOT.base_from_tcp(q_rad), np.array([0.0, 0.0, -down_m]))
    assert points is not None
    return points


DOWN = blended([line(0.10)])
GRASP_RAD = DOWN.points_rad[-1]


def bounded(near_m: float | None) -> Trajectory:
    """The way down; something is believed to be near the hand in the last so many metres; None = nowhere."""
    end_m = ROBOT.base_from_tcp(GRASP_RAD)[2, 3]

    def is_near(q_rad: Joints) -> bool:
        return near_m is not None and ROBOT.base_from_tcp(q_rad)[2, 3] - end_m < near_m

    return timed(STATION, DOWN, slow_end=slow_end(ROBOT, DOWN.points_rad, SETTINGS, is_near, is_near))


SLOW = bounded(0.001)


def tcp_m(commands: JointSamples) -> np.ndarray:
    return np.array([ROBOT.base_from_tcp(q)[:3, 3] for q in commands])


def test_the_end_is_slow_and_the_rest_is_not() -> None:
    at_m = tcp_m(SLOW.filtered())
    speed_m_s = np.linalg.norm(np.diff(at_m, axis=0), axis=1) * 1000
    left_m = np.linalg.norm(at_m - at_m[-1], axis=1)[1:]
    assert speed_m_s[left_m < 0.9 * SETTINGS.slow_m].max() < 1.1 * SETTINGS.slow_m_s
    assert speed_m_s.max() > 10 * SETTINGS.slow_m_s
    assert check(SLOW.filtered()).ok


def test_where_nothing_is_believed_to_be_near_it_is_less_slow() -> None:
    free = bounded(None)
    assert timed(STATION, DOWN).duration_s + 0.1 < free.duration_s < SLOW.duration_s - 0.5
    scene = Scene.of(ROBOT, STATION)
    for height_m, is_near in ((0.0, True), (0.05, False)):
        down_m = ROBOT.base_from_tcp(ABOVE_RAD)[2, 3] - FINGER_TIP_M - 0.003 - height_m
        assert scene.is_near(line(down_m)[-1], 0.05) == is_near, height_m


def test_where_the_hand_passes_something_it_is_slower_before_the_end_at_little_time() -> None:
    beside = bounded(0.1)
    at_m = tcp_m(beside.filtered())
    speed_m_s = np.linalg.norm(np.diff(at_m, axis=0), axis=1) * 1000
    left_m = np.linalg.norm(at_m - at_m[-1], axis=1)[1:]
    assert speed_m_s[left_m < SETTINGS.slow_m + 0.8 * SETTINGS.beside_m].max() < 1.1 * SETTINGS.beside_m_s
    assert speed_m_s[left_m < 0.9 * SETTINGS.slow_m].max() < 1.1 * SETTINGS.slow_m_s
    assert SLOW.duration_s < beside.duration_s < SLOW.duration_s + 0.2, (
        "what a pick loses that passes something all the way"
    )
    lower = bounded(SETTINGS.slow_m + 0.6 * SETTINGS.beside_m)
    assert SLOW.duration_s < lower.duration_s < beside.duration_s, "it is passed later"


def test_an_arm_that_feels_nothing_moves_as_ever() -> None:
    numb = SETTINGS.model_copy(update={"contact_n": 0.0})
    assert slow_end(ROBOT, DOWN.points_rad, numb, bool, bool) is None
    assert timed(STATION, DOWN).duration_s < SLOW.duration_s - 0.5


def test_the_force_is_that_on_the_tcp_against_the_motion() -> None:
    felt = guard(ROBOT, SLOW, 0, 5.0)
    for row, at in ((0, 0), (-1, -1)):
        q_rad = SLOW.filtered()[at]
        torque_nm = ROBOT.jacobian(q_rad).T @ np.array([3.0, -2.0, 7.0, 0.4, 0.2, -0.1])
        assert felt.force_from_torque[row] @ torque_nm == pytest.approx(7.0, abs=1e-6), "upwards, against a way down"


@pytest.mark.parametrize(
    ("above_tcp_m", "within_m"),
    [(None, FINGER_TIP_M - 0.001), (0.03, FINGER_TIP_M - 0.001), (-0.004, FINGER_TIP_M - 0.005), (-0.02, -0.0115)],
)
def test_the_fingers_close_only_where_their_tips_reach_the_thing(above_tcp_m: float | None, within_m: float) -> None:
    top_m = None if above_tcp_m is None else ROBOT.base_from_tcp(GRASP_RAD)[2, 3] + above_tcp_m
    assert closes_within_m(ROBOT, GRASP_RAD, top_m) == pytest.approx(within_m, abs=1e-3)


def test_the_way_back_is_the_way_down_without_what_it_went_to_and_fro() -> None:
    whole = SLOW.filtered()
    met = np.concatenate([whole[:900], whole[900:880:-1]])
    back = way_back(STATION, met).filtered()
    np.testing.assert_allclose(back[0], met[-1], atol=1e-9)
    np.testing.assert_allclose(back[-1], whole[0], atol=1e-6)
    assert check(back).ok and (np.diff(tcp_m(back)[:, 2]) > -1e-6).all(), "it goes down again"


def test_a_carry_is_joined_from_above_its_start_within_the_lift() -> None:
    up = timed(STATION, blended([line(0.15)[::-1]]))
    early_m, start_m = 0.008, ROBOT.base_from_tcp(up.start_q_rad)
    q_rad = tcp_line(FR3_ARM, up.start_q_rad, start_m, np.array([0.0, 0.0, early_m]))
    assert q_rad is not None
    way: Trajectory = joined(ROBOT, STATION, up, q_rad[-1])
    commands, height_m = way.filtered(), tcp_m(way.filtered())[:, 2] - start_m[2, 3]
    np.testing.assert_allclose(commands[0], q_rad[-1], atol=1e-9)
    np.testing.assert_allclose(commands[-1], up.end_q_rad, atol=1e-9)
    assert height_m.min() > early_m - 1e-4 and check(commands).ok
    aside_m = np.linalg.norm(tcp_m(commands)[:, :2] - start_m[:2, 3], axis=1)
    assert aside_m.max() < 1e-3
