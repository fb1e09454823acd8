"""The FR3's control loop and its driver, without a robot: a frozen driver, stops at odd moments, a set wall clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from bus.errors import DeviceLost, DriverUnavailable, MotionRefused
from bus.messages import ArmMode, Motion
from bus.trajectory import ContactGuard, Trajectory
from config.hardware import Fr3Settings
from config.limits import check
from config.load import load_station
from drivers.fr3.arm import Fr3Arm
from drivers.fr3.loop import SILENT_NS, ControlLoop, Request
from drivers.fr3.player import Played
from drivers.fr3.process import ControlProcess
from drivers.fr3.shared_state import MotionRequest, RobotSnapshot, SharedState
from stand_ins.fci import FakeFci

START_RAD = np.array([0.0, -0.55, 0.0, -2.1, 0.0, 1.55, 0.785])
TICK_NS = 1_000_000


def fast(duration_s: float = 4.0) -> Trajectory:
    """Joint 1, 1.2 rad there and back, up to 1.5 rad/s."""
    ticks = round(duration_s * 1000)
    raw_q_rad = np.repeat(START_RAD[None], ticks, axis=0)
    raw_q_rad[:, 0] += 1.2 * (0.5 - 0.5 * np.cos(np.linspace(0.0, 2 * np.pi, ticks))) ** 2
    return Trajectory(raw_q_rad=raw_q_rad, window=64)


def played(
    beats: Callable[[int], bool],
    wants: dict[int, MotionRequest] | None = None,
    guard: ContactGuard | None = None,
    touches_at: int | None = None,
) -> Played:
    """Return what a loop plays of `fast` whose driver beats in the milliseconds of ``beats``, and asks ``wants``.

    From ``touches_at`` on the robot feels 8 Nm on joint 1.
    """
    now_ns, shared = [5_000 * TICK_NS], SharedState.create()

    def on_cycle(cycle: int) -> None:
        now_ns[0] += TICK_NS
        if beats(cycle):
            shared.beat(now_ns[0])
        if wants is not None and cycle in wants:
            shared.ask(wants[cycle])
        if cycle == touches_at:
            robot.tau_ext_nm = np.array([8.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])

    robot = FakeFci(START_RAD, on_cycle)
    settings = Fr3Settings(realtime="ignore")
    loop = ControlLoop(robot.package(), settings, shared, gone=lambda: False, clock_ns=lambda: now_ns[0])
    return loop.play(fast().model_copy(update={"guard": guard}), tolerance_rad=0.02)


def test_while_its_driver_lives_a_motion_is_played_to_its_end() -> None:
    whole = played(lambda cycle: cycle % 50 == 0)
    assert whole.finished and len(whole.commanded_q_rad) == len(fast().filtered())


def test_a_driver_that_is_late_by_less_than_half_a_second_changes_nothing() -> None:
    assert played(lambda cycle: not 1000 < cycle < 1490).finished


@pytest.mark.parametrize("frozen_at", [300, 1000, 1500, 2600])
def test_a_frozen_driver_brakes_the_motion_on_its_path_within_a_second(frozen_at: int) -> None:
    cut = played(lambda cycle: cycle < frozen_at)
    assert not cut.finished
    assert SILENT_NS / TICK_NS <= len(cut.commanded_q_rad) - frozen_at < 1000
    report = check(cut.commanded_q_rad)
    assert report.ok, report.describe()
    assert np.abs(cut.commanded_q_rad[:, 1:] - START_RAD[1:]).max() < 1e-9, "it leaves the path"
    np.testing.assert_allclose(cut.commanded_q_rad[-1], cut.commanded_q_rad[-2], atol=1e-5)


def test_a_driver_that_thaws_again_does_not_go_on_with_what_was_braked() -> None:
    assert not played(lambda cycle: not 1000 < cycle < 1600).finished


def test_a_driver_that_freezes_in_a_hold_ends_the_held_motion() -> None:
    cut = played(lambda cycle: cycle < 2000, {800: MotionRequest.HOLD})
    assert not cut.finished and len(cut.commanded_q_rad) < 1300


def test_a_driver_that_never_said_that_it_lives_moves_nothing_far() -> None:
    cut = played(lambda _: False)
    assert not cut.finished and np.abs(cut.commanded_q_rad - START_RAD).max() < 1e-3


GUARD = ContactGuard(begins_at=500, limit_n=5.0, force_from_torque=np.eye(7)[:1])


def test_a_guarded_motion_that_meets_something_brakes_in_the_loop_within_milliseconds() -> None:
    cut = played(lambda _: True, guard=GUARD, touches_at=1200)
    assert cut.contact_n == pytest.approx(8.0) and not cut.finished
    slower = np.flatnonzero(np.abs(cut.commanded_q_rad - fast().filtered()[: len(cut.commanded_q_rad)]).max(1) > 1e-9)
    assert 1200 < slower[0] < 1206
    report = check(cut.commanded_q_rad)
    assert report.ok, report.describe()


def test_a_guarded_motion_that_meets_nothing_is_played_to_its_end() -> None:
    whole = played(lambda _: True, guard=GUARD)
    assert whole.finished and whole.contact_n is None


# --- the driver -------------------------------------------------------------------------------------------------------


class Bench:
    """An arm whose control process is this object: it answers every motion with what it was asked to do then."""

    def __init__(self) -> None:
        self.shared = SharedState.create()
        self.before: Callable[[], None] = lambda: None  # when a motion is about to begin
        self.during: Callable[[], None] = lambda: None
        self.wants: list[MotionRequest] = []
        self.is_lost = False

    def __call__(self, _: Fr3Settings) -> ControlProcess:
        return cast(ControlProcess, self)

    def snapshot(self) -> RobotSnapshot:
        before, self.before = self.before, lambda: None
        before()
        none, now_ns = np.zeros(7), time.monotonic_ns()
        return RobotSnapshot(time.time_ns(), now_ns, 1, 1.0, 0, False, START_RAD, none, none, START_RAD)

    def answer(self, _: Request) -> Played:
        self.during()
        self.wants.append(MotionRequest(self.shared.want))
        is_stopped = self.wants[-1] is MotionRequest.STOP
        return Played(not is_stopped, START_RAD[None], np.zeros(1), START_RAD[None], np.zeros((1, 7)), np.zeros((1, 7)))

    def end(self) -> None: ...


@contextmanager
def connected(bench: Bench) -> Iterator[Fr3Arm]:
    arm = Fr3Arm(load_station(), bench)
    arm.connect()
    yield arm
    arm.close()


def test_a_stop_between_the_question_and_the_motion_wins() -> None:
    bench = Bench()
    with connected(bench) as arm:
        bench.before = arm.stop
        motion = arm.execute(fast())
        assert not motion.finished and bench.wants == [], "the control process is not even asked"
        assert arm.execute(fast()).finished, "a motion asked for after a stop runs"


def test_a_hold_between_the_question_and_the_motion_is_kept() -> None:
    bench = Bench()
    with connected(bench) as arm:
        bench.before = arm.hold
        arm.execute(fast())
        assert bench.wants == [MotionRequest.HOLD]
        with pytest.raises(MotionRefused, match="held"):
            arm.resume()


@pytest.mark.parametrize("error", [None, DeviceLost("The robot fell silent."), KeyError("unforeseen")])
def test_after_a_motion_however_it_ended_nothing_is_to_move_and_the_arm_is_idle(error: Exception | None) -> None:
    bench = Bench()

    def fail() -> None:
        assert arm.state().mode is ArmMode.MOVE
        if error is not None:
            raise error

    with connected(bench) as arm:
        bench.during = fail
        try:
            arm.execute(fast())
        except (DeviceLost, KeyError) as raised:
            assert raised is error
        assert bench.shared.want == MotionRequest.STOP and arm.state().mode is ArmMode.IDLE


def test_an_unasked_brake_is_said(caplog: pytest.LogCaptureFixture) -> None:
    bench = Bench()
    with connected(bench) as arm:
        bench.during = lambda: bench.shared.ask(MotionRequest.STOP)  # as the control process does for a frozen driver
        motion: Motion = arm.execute(fast())
    assert not motion.finished and "stood still" in caplog.text


# --- its clocks, and its process --------------------------------------------------------------------------------------


def test_the_age_of_a_state_is_by_the_clock_that_nobody_sets() -> None:
    shared, state = SharedState.create(), FakeFci(START_RAD, lambda _: None).read_once()
    for hours in (-3, 3):
        wrong_ns = time.time_ns() + hours * 3_600_000_000_000
        shared.write(wrong_ns, time.monotonic_ns(), state, 0)
        now = shared.read()
        assert now is not None and now.stamp_ns == wrong_ns
        assert 0 <= time.monotonic_ns() - now.heard_ns < 1e9


def test_a_config_py_in_the_working_folder_keeps_no_control_process_from_starting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("config.py", "drivers.py", "bus.py"):
        (tmp_path / name).write_text("raise SystemExit('shadowed')\n")
    monkeypatch.chdir(tmp_path)
    settings: Any = {"address": "127.0.0.9", "realtime": "ignore"}
    with pytest.raises(DriverUnavailable) as refused:
        ControlProcess(Fr3Settings(**settings))
    assert "ended at once" not in refused.value.text
