"""The checks that every arm passes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import ClassVar

import numpy as np
import pytest

from bus.errors import MotionRefused, NotConnected
from bus.messages import ArmMode, Motion
from bus.trajectory import TICK_S, ContactGuard, Trajectory
from config.robot import limits_of
from config.schema import Station
from drivers.interface import Arm, Devices
from vlad_cell.testing.devices import DriverSuite

REST_RAD_S = 0.1
"""Measured velocities chatter by up to 0.08 rad/s at standstill, on the real arm's simulator as on the arm."""
_AWAY_RAD, _BACK_RAD_S = 0.02, 0.3
"""An arm so far from where it was at first is moved back, at this mean speed."""
START_RAD = 5e-3
"""An arm may be commanded to be so far from where it is measured: there a motion begins; it ends as planned."""


def _nod(start_q_rad: np.ndarray, by_rad: float = 0.2, duration_s: float = 1.6) -> Trajectory:
    """There and back on the last joint, at rest at both ends, far below the limits: then a late command breaks none."""
    ticks = round(duration_s / TICK_S)
    phase = np.linspace(0.0, 1.0, ticks)
    raw_q_rad = np.repeat(np.asarray(start_q_rad)[None], ticks, axis=0)
    raw_q_rad[:, -1] += by_rad * (0.5 - 0.5 * np.cos(2 * np.pi * phase)) ** 2
    return Trajectory(raw_q_rad=raw_q_rad, window=64)


def _back_to(arm: Arm, q_rad: np.ndarray) -> None:
    """Move the last joint to where it was, slowly: a check that stops a motion leaves it anywhere on the way."""
    now_q_rad = arm.state().q_rad
    away_rad = q_rad[-1] - now_q_rad[-1]
    if abs(away_rad) < _AWAY_RAD:
        return
    phase = np.linspace(0.0, 1.0, round(max(0.5, abs(away_rad) / _BACK_RAD_S) / TICK_S))
    raw_q_rad = np.repeat(np.asarray(now_q_rad)[None], len(phase), axis=0)
    raw_q_rad[:, -1] += away_rad * (phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2))
    assert arm.execute(Trajectory(raw_q_rad=raw_q_rad, window=64)).finished


class _Running:
    """A long motion in a thread of its own, under way when this returns. Raises: what the arm refuses it with."""

    def __init__(self, arm: Arm, long_s: float, waits_at: int | None = None) -> None:
        self._arm = arm
        self.start_q_rad = arm.state().q_rad
        nod = _nod(self.start_q_rad, by_rad=1.2, duration_s=long_s)
        self.trajectory = nod.model_copy(update={"waits_at": waits_at})
        self.ended: list[Motion] = []
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        _wait_until(lambda: self._error is not None or bool(np.abs(arm.state().q_rad - self.start_q_rad).max() >= 0.01))
        self._raise()

    def _run(self) -> None:
        try:
            self.ended.append(self._arm.execute(self.trajectory))
        except Exception as error:  # noqa: BLE001 - raised where it is waited for
            self._error = error

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def end(self) -> Motion:
        self._thread.join(timeout=60)
        self._raise()
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
    """Whether it is at the same place four times: a busy machine may give it no time in between once."""
    places = [arm.state().q_rad]
    for _ in range(3):
        time.sleep(0.05)
        places.append(arm.state().q_rad)
    return bool(np.ptp(places, axis=0).max() < 2e-4)


class ArmSuite(DriverSuite):
    """The checks of an arm. Only its last joint moves: up to 1.2 rad towards its upper limit, and back.

    Attributes:
        long_s: a motion of so long can be interrupted, and is waited for; 20 s where simulated time passes faster.
    """

    long_s: ClassVar[float] = 5.0

    @pytest.fixture(scope="class")
    @classmethod
    def first_q_rad(cls, devices: Devices) -> list[np.ndarray]:
        """Return where the arm was at the first check, once it was seen; every other begins there, too."""
        return []

    @pytest.fixture
    def arm(self, devices: Devices, first_q_rad: list[np.ndarray]) -> Iterator[Arm]:
        """Yield the arm, connected, where it was at first."""
        assert devices.arm is not None, "the driver brings no arm"
        devices.arm.connect()
        if devices.arm.state().mode is ArmMode.REFLEX:  # of a check that is tried again
            devices.arm.recover()
        if first_q_rad:
            _back_to(devices.arm, first_q_rad[0])
        else:
            first_q_rad.append(devices.arm.state().q_rad)
        yield devices.arm

    @pytest.fixture(name="long_s")
    def given_long_s(self, station: Station) -> float:
        """Return the duration of a long motion."""
        return 20.0 if station.is_simulation and station.sim.pace == 0 else self.long_s

    def test_it_implements_the_protocol(self, devices: Devices) -> None:
        assert isinstance(devices.arm, Arm)

    def test_at_rest_it_is_idle_and_finite(self, arm: Arm) -> None:
        state = arm.state()
        assert state.mode is ArmMode.IDLE and np.isfinite(state.q_rad).all()
        assert np.abs(state.dq_rad_s).max() < REST_RAD_S
        assert abs(time.time_ns() - state.stamp_ns) < 5e9

    def test_it_plays_a_trajectory_to_its_end(self, arm: Arm, station: Station) -> None:
        start_q_rad = arm.state().q_rad
        trajectory = _nod(start_q_rad)
        motion = arm.execute(trajectory)
        assert motion.finished
        np.testing.assert_allclose(motion.commanded_q_rad, trajectory.filtered(), atol=START_RAD)
        np.testing.assert_allclose(motion.commanded_q_rad[-1], trajectory.end_q_rad, atol=1e-9)
        np.testing.assert_allclose(arm.state().q_rad, start_q_rad, atol=5e-3)
        assert limits_of(station).check(motion.commanded_q_rad).ok

    def test_it_measures_while_it_moves(self, arm: Arm) -> None:
        motion = arm.execute(_nod(arm.state().q_rad))
        assert len(motion.t_s) == len(motion.q_rad) == len(motion.dq_rad_s) == len(motion.tau_ext_nm)
        assert np.allclose(np.diff(motion.t_s), 0.01, atol=0.0051)
        commanded = motion.commanded_q_rad[
            np.minimum((motion.t_s / TICK_S).round().astype(int), len(motion.commanded_q_rad) - 1)
        ]
        assert np.abs(motion.q_rad - commanded).max() < 0.03
        assert np.abs(motion.q_rad[:, -1] - motion.q_rad[0, -1]).max() > 0.15

    def test_a_stop_brakes_on_the_path_within_limits(self, arm: Arm, long_s: float) -> None:
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

    def test_stop_at_rest_does_nothing_and_never_raises(self, arm: Arm) -> None:
        before = arm.state().q_rad
        arm.stop()
        np.testing.assert_allclose(arm.state().q_rad, before, atol=2e-3)

    def test_recover_at_rest_changes_nothing(self, arm: Arm) -> None:
        arm.recover()
        assert arm.state().mode is ArmMode.IDLE

    def test_before_connect_and_after_close_it_says_so(self, devices: Devices) -> None:
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

    def test_a_held_motion_rests_and_goes_on_to_exactly_its_end(self, arm: Arm, long_s: float) -> None:
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

    def test_a_stop_ends_a_held_motion_where_it_rests(self, arm: Arm, long_s: float) -> None:
        running = _Running(arm, long_s)
        _hold(arm)
        held_q_rad = arm.state().q_rad
        arm.stop()
        assert not running.end().finished
        np.testing.assert_allclose(arm.state().q_rad, held_q_rad, atol=2e-3)
        with pytest.raises(MotionRefused):
            arm.resume()

    def test_a_hold_after_a_stop_keeps_nothing_waiting(self, arm: Arm, long_s: float) -> None:
        running = _Running(arm, long_s)
        arm.stop()
        arm.hold()
        assert not running.end().finished

    def test_resume_without_a_hold_is_refused(self, arm: Arm, long_s: float) -> None:
        with pytest.raises(MotionRefused, match="held"):
            arm.resume()
        running = _Running(arm, long_s)
        with pytest.raises(MotionRefused, match="held"):
            arm.resume()
        arm.stop()
        running.end()

    def test_one_that_waits_rests_before_its_tick_and_goes_on_when_resumed(self, arm: Arm, long_s: float) -> None:
        waits_at = round(0.25 * long_s / TICK_S)
        running = _Running(arm, long_s, waits_at)
        limit_rad = running.trajectory.filtered()[waits_at, -1]
        _wait_until(lambda: _rests(arm))
        assert arm.state().mode is ArmMode.MOVE and not running.ended
        assert arm.state().q_rad[-1] <= limit_rad + START_RAD
        arm.resume()
        motion = running.end()
        assert motion.finished and arm.state().mode is ArmMode.IDLE
        np.testing.assert_allclose(motion.commanded_q_rad[-1], running.trajectory.end_q_rad, atol=1e-9)

    def test_one_that_is_resumed_in_time_plays_as_if_it_did_not_wait(self, arm: Arm, long_s: float) -> None:
        running = _Running(arm, long_s, round(0.75 * long_s / TICK_S))
        arm.resume()
        motion = running.end()
        assert motion.finished
        np.testing.assert_allclose(motion.commanded_q_rad, running.trajectory.filtered(), atol=START_RAD)

    def test_a_stop_ends_one_that_waits(self, arm: Arm, long_s: float) -> None:
        running = _Running(arm, long_s, round(0.25 * long_s / TICK_S))
        arm.stop()
        assert not running.end().finished
        with pytest.raises(MotionRefused):
            arm.resume()

    def test_a_guarded_motion_that_meets_nothing_is_played_as_any_other(self, arm: Arm) -> None:
        free = _nod(arm.state().q_rad)
        guard = ContactGuard(begins_at=100, limit_n=5.0, force_from_torque=np.eye(len(free.end_q_rad)))
        motion = arm.execute(free.model_copy(update={"guard": guard}))
        assert motion.finished and motion.contact_n is None
        np.testing.assert_allclose(motion.commanded_q_rad, free.filtered(), atol=START_RAD)

    def test_a_hold_without_a_motion_does_nothing_and_holds_no_later_one(self, arm: Arm) -> None:
        arm.hold()
        assert arm.state().mode is ArmMode.IDLE
        assert arm.execute(_nod(arm.state().q_rad)).finished

    def test_hold_never_raises(self, devices: Devices) -> None:
        arm = devices.arm
        assert arm is not None
        arm.close()
        arm.hold()
        with pytest.raises(NotConnected):
            arm.resume()
