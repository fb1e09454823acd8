"""What every arm does."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

from bus.errors import MotionRefused, NotConnected
from bus.messages import ArmMode, Motion
from bus.trajectory import TICK_S, ContactGuard, Trajectory
from config.franka_hand import FINGER_TIP_M
from config.limits import check
from config.load import load_station
from drivers.fr3.arm import Fr3Arm
from drivers.interface import Arm, Devices
from planning.blend import blended
from planning.feeling import guard, way_back
from planning.line import tcp_line
from planning.robot import Robot
from planning.slow_end import slow_end
from planning.timing import timed

REST_RAD_S = 0.1
"""Measured velocities chatter by up to 0.08 rad/s at standstill, on the real arm's simulator as on the arm."""
START_RAD = 5e-3
"""An arm may be commanded to be so far from where it is measured: there a motion begins; it ends as planned."""


def _nod(start_q_rad: np.ndarray, by_rad: float = 0.2, duration_s: float = 1.6) -> Trajectory:
    """There and back on joint 7, at rest at both ends, well below the limits: then a late command breaks none."""
    ticks = round(duration_s / TICK_S)
    phase = np.linspace(0.0, 1.0, ticks)
    raw_q_rad = np.repeat(np.asarray(start_q_rad)[None], ticks, axis=0)
    raw_q_rad[:, 6] += by_rad * (0.5 - 0.5 * np.cos(2 * np.pi * phase)) ** 2
    return Trajectory(raw_q_rad=raw_q_rad, window=64)


def test_it_implements_the_protocol(devices: Devices) -> None:
    assert isinstance(devices.arm, Arm)


def test_at_rest_it_is_idle_and_finite(arm: Arm) -> None:
    state = arm.state()
    assert state.mode is ArmMode.IDLE and np.isfinite(state.q_rad).all()
    assert np.abs(state.dq_rad_s).max() < REST_RAD_S
    assert abs(time.time_ns() - state.stamp_ns) < 5e9


def test_it_plays_a_trajectory_to_its_end(arm: Arm) -> None:
    start_q_rad = arm.state().q_rad
    trajectory = _nod(start_q_rad)
    motion = arm.execute(trajectory)
    assert motion.finished
    np.testing.assert_allclose(motion.commanded_q_rad, trajectory.filtered(), atol=START_RAD)
    np.testing.assert_allclose(motion.commanded_q_rad[-1], trajectory.end_q_rad, atol=1e-9)
    np.testing.assert_allclose(arm.state().q_rad, start_q_rad, atol=5e-3)
    assert check(motion.commanded_q_rad).ok


def test_it_measures_while_it_moves(arm: Arm) -> None:
    motion = arm.execute(_nod(arm.state().q_rad))
    assert len(motion.t_s) == len(motion.q_rad) == len(motion.dq_rad_s) == len(motion.tau_ext_nm)
    assert np.allclose(np.diff(motion.t_s), 0.01, atol=0.0051)
    commanded = motion.commanded_q_rad[
        np.minimum((motion.t_s / TICK_S).round().astype(int), len(motion.commanded_q_rad) - 1)
    ]
    assert np.abs(motion.q_rad - commanded).max() < 0.03
    assert np.abs(motion.q_rad[:, 6] - motion.q_rad[0, 6]).max() > 0.15


def test_a_stop_brakes_on_the_path_within_limits(arm: Arm, long_s: float) -> None:
    trajectory = _nod(arm.state().q_rad, by_rad=1.2, duration_s=long_s)
    ended: list[bool] = []
    runner = threading.Thread(target=lambda: ended.append(arm.execute(trajectory).finished))
    start_q_rad = arm.state().q_rad
    runner.start()
    give_up_s = time.monotonic() + 60
    while np.abs(arm.state().q_rad - start_q_rad).max() < 0.01 and time.monotonic() < give_up_s:
        time.sleep(0.001)
    arm.stop()
    runner.join(timeout=60)
    assert ended == [False]
    assert np.abs(arm.state().dq_rad_s).max() < REST_RAD_S
    back = arm.execute(Trajectory(raw_q_rad=arm.state().q_rad[None], window=1))
    assert back.finished


def test_stop_at_rest_does_nothing_and_never_raises(arm: Arm) -> None:
    before = arm.state().q_rad
    arm.stop()
    np.testing.assert_allclose(arm.state().q_rad, before, atol=2e-3)


def test_recover_at_rest_changes_nothing(arm: Arm) -> None:
    arm.recover()
    assert arm.state().mode is ArmMode.IDLE


def test_before_connect_and_after_close_it_says_so(devices: Devices) -> None:
    arm = devices.arm
    assert arm is not None
    arm.connect()
    arm.close()
    arm.close()
    with pytest.raises(NotConnected):
        arm.state()
    arm.stop()
    arm.connect()
    assert arm.state().mode is ArmMode.IDLE


# --- hold and resume --------------------------------------------------------------------------------------------------


class _Running:
    """A long motion in a thread of its own, under way when this returns."""

    def __init__(self, arm: Arm, long_s: float, waits_at: int | None = None) -> None:
        self._arm = arm
        self.start_q_rad = arm.state().q_rad
        nod = _nod(self.start_q_rad, by_rad=1.2, duration_s=long_s)
        self.trajectory = nod.model_copy(update={"waits_at": waits_at})
        self.ended: list[Motion] = []
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        _wait_until(lambda: bool(np.abs(arm.state().q_rad - self.start_q_rad).max() >= 0.01))

    def _run(self) -> None:
        self.ended.append(self._arm.execute(self.trajectory))

    def end(self) -> Motion:
        self._thread.join(timeout=60)
        (motion,) = self.ended
        return motion


def _wait_until(holds: Callable[[], bool]) -> None:
    give_up_s = time.monotonic() + 60
    while not holds():
        assert time.monotonic() < give_up_s
        time.sleep(0.001)


def _hold(arm: Arm) -> None:
    """Hold, and wait until the arm rests."""
    arm.hold()
    _wait_until(lambda: _rests(arm))


def _rests(arm: Arm) -> bool:
    """Whether it is at the same place twice."""
    before_q_rad = arm.state().q_rad
    time.sleep(0.05)
    return bool(np.abs(arm.state().q_rad - before_q_rad).max() < 2e-4)


def test_a_held_motion_rests_and_goes_on_to_exactly_its_end(arm: Arm, long_s: float) -> None:
    running = _Running(arm, long_s)
    _hold(arm)
    held = arm.state()
    assert held.mode is ArmMode.MOVE and not running.ended
    arm.hold()
    np.testing.assert_allclose(arm.state().q_rad, held.q_rad, atol=1e-3)
    arm.resume()
    motion = running.end()
    assert motion.finished and arm.state().mode is ArmMode.IDLE
    np.testing.assert_allclose(motion.commanded_q_rad[-1], running.trajectory.end_q_rad, atol=1e-9)
    np.testing.assert_allclose(arm.state().q_rad, running.trajectory.end_q_rad, atol=5e-3)
    assert np.abs(np.diff(motion.commanded_q_rad, axis=0)).max() < 2e-3


def test_a_stop_ends_a_held_motion_where_it_rests(arm: Arm, long_s: float) -> None:
    running = _Running(arm, long_s)
    _hold(arm)
    held_q_rad = arm.state().q_rad
    arm.stop()
    assert not running.end().finished
    np.testing.assert_allclose(arm.state().q_rad, held_q_rad, atol=2e-3)
    with pytest.raises(MotionRefused):
        arm.resume()


def test_a_hold_after_a_stop_keeps_nothing_waiting(arm: Arm, long_s: float) -> None:
    running = _Running(arm, long_s)
    arm.stop()
    arm.hold()
    assert not running.end().finished


def test_resume_without_a_hold_is_refused(arm: Arm, long_s: float) -> None:
    with pytest.raises(MotionRefused, match="held"):
        arm.resume()
    running = _Running(arm, long_s)
    with pytest.raises(MotionRefused, match="held"):
        arm.resume()
    arm.stop()
    running.end()


def test_one_that_waits_rests_before_its_tick_and_goes_on_when_resumed(arm: Arm, long_s: float) -> None:
    waits_at = round(0.25 * long_s / TICK_S)
    running = _Running(arm, long_s, waits_at)
    limit_rad = running.trajectory.filtered()[waits_at, 6]
    _wait_until(lambda: _rests(arm))
    assert arm.state().mode is ArmMode.MOVE and not running.ended
    assert arm.state().q_rad[6] <= limit_rad + START_RAD
    arm.resume()
    motion = running.end()
    assert motion.finished and arm.state().mode is ArmMode.IDLE
    np.testing.assert_allclose(motion.commanded_q_rad[-1], running.trajectory.end_q_rad, atol=1e-9)


def test_one_that_is_resumed_in_time_plays_as_if_it_did_not_wait(arm: Arm, long_s: float) -> None:
    running = _Running(arm, long_s, round(0.75 * long_s / TICK_S))
    arm.resume()
    motion = running.end()
    assert motion.finished
    np.testing.assert_allclose(motion.commanded_q_rad, running.trajectory.filtered(), atol=START_RAD)


def test_a_stop_ends_one_that_waits(arm: Arm, long_s: float) -> None:
    running = _Running(arm, long_s, round(0.25 * long_s / TICK_S))
    arm.stop()
    assert not running.end().finished
    with pytest.raises(MotionRefused):
        arm.resume()


def test_a_guarded_motion_that_meets_nothing_is_played_as_any_other(arm: Arm) -> None:
    free = _nod(arm.state().q_rad)
    guard = ContactGuard(begins_at=100, limit_n=5.0, force_from_torque=np.eye(7))
    motion = arm.execute(free.model_copy(update={"guard": guard}))
    assert motion.finished and motion.contact_n is None
    np.testing.assert_allclose(motion.commanded_q_rad, free.filtered(), atol=START_RAD)


def test_a_guarded_motion_brakes_by_itself_where_it_meets_the_table(arm: Arm) -> None:
    if isinstance(arm, Fr3Arm):
        pytest.skip("its simulator tells no external torques; see test_fr3_loop")
    start_q_rad = arm.state().q_rad
    down = _into_the_table(start_q_rad)
    motion = arm.execute(down)
    assert motion.contact_n is not None and motion.contact_n > load_station().execute.contact_n and not motion.finished
    assert arm.state().mode is ArmMode.IDLE, "a reflex"
    assert arm.execute(down.model_copy(update={"raw_q_rad": _back(motion), "guard": None})).finished
    np.testing.assert_allclose(arm.state().q_rad, start_q_rad, atol=5e-3)


def _into_the_table(start_q_rad: np.ndarray) -> Trajectory:
    """Straight down until the finger tips are 3 mm in the table, slow at its end, and guarded."""
    station = load_station()
    robot, pose = Robot(station), Robot(station).base_from_tcp(start_q_rad)
    line = tcp_line(start_q_rad, pose, np.array([0.0, 0.0, FINGER_TIP_M - 0.003 - pose[2, 3]]))
    assert line is not None
    slow = slow_end(robot, line, station.execute, lambda _: True, lambda _: False)
    reach = timed(station, blended([line]), slow_end=slow)
    return reach.model_copy(update={"guard": guard(robot, reach, 100, station.execute.contact_n)})


def _back(motion: Motion) -> np.ndarray:
    return way_back(load_station(), motion.commanded_q_rad).raw_q_rad


def test_a_hold_without_a_motion_does_nothing_and_holds_no_later_one(arm: Arm) -> None:
    arm.hold()
    assert arm.state().mode is ArmMode.IDLE
    assert arm.execute(_nod(arm.state().q_rad)).finished


def test_hold_never_raises(devices: Devices) -> None:
    arm = devices.arm
    assert arm is not None
    arm.close()
    arm.hold()
    with pytest.raises(NotConnected):
        arm.resume()
