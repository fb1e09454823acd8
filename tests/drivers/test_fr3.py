"""The FR3's driver against the strict simulator: every limit and the 1 kHz deadline are enforced there."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from bus.errors import ArmReflex, DeviceLost, DriverError, DriverUnavailable, MotionRefused
from bus.messages import ArmMode, Grasp, Motion
from bus.trajectory import TICK_S, Trajectory
from config.hardware import Fr3Settings
from config.load import load_station
from config.schema import Station
from drivers.fr3.arm import Fr3Arm
from drivers.fr3.shared_state import RobotSnapshot, SharedState
from planning.motion import move
from planning.pick import plan_pick
from planning.robot import Robot
from planning.scene import Scene
from stand_ins.franka import FrankaSim, missing

pytestmark = pytest.mark.realtime
_REALTIME_KERNEL = Path("/sys/kernel/realtime")


@pytest.fixture(scope="module")
def station() -> Station:
    return load_station(overrides=["arm.speed=0.35"])


@pytest.fixture(scope="module")
def sim() -> Iterator[FrankaSim]:
    why = missing()
    if why is not None:
        pytest.skip(f"no FR3: {why}")
    with FrankaSim() as sim:
        yield sim


@pytest.fixture(scope="module")
def driver(station: Station, sim: FrankaSim) -> Iterator[Fr3Arm]:
    """The module's one driver, which is not connected where a test closed it."""
    here = Fr3Settings(address="127.0.0.1", realtime="ignore")
    driver = Fr3Arm(station.model_copy(update={"fr3": here}))
    yield driver
    driver.close()


@pytest.fixture
def arm(driver: Fr3Arm) -> Fr3Arm:
    driver.connect()
    if driver.state().mode is ArmMode.REFLEX:  # of a test that is tried again
        driver.recover()
    return driver


@pytest.fixture
def free(sim: FrankaSim, driver: Fr3Arm) -> FrankaSim:
    """The robot, which takes one driver at a time, without ours."""
    driver.close()
    return sim


def nod(arm: Fr3Arm, by_rad: float = 0.8, duration_s: float = 5.0) -> Trajectory:
    """There and back on joint 7, with less than a third of the allowed acceleration."""
    raw_q_rad = np.repeat(arm.state().q_rad[None], round(duration_s / TICK_S), axis=0)
    raw_q_rad[:, 6] += by_rad * (0.5 - 0.5 * np.cos(np.linspace(0.0, 2 * np.pi, len(raw_q_rad)))) ** 2
    return Trajectory(raw_q_rad=raw_q_rad, window=64)


class Running:
    """A motion in a thread of its own, under way when this returns."""

    def __init__(self, arm: Fr3Arm) -> None:
        start_q_rad = arm.state().q_rad
        self.ended: Motion | DriverError | None = None
        self._thread = threading.Thread(target=self._run, args=(arm, nod(arm)), daemon=True)
        self._thread.start()
        wait_until(lambda: bool(np.abs(arm.state().q_rad - start_q_rad).max() > 0.1))

    def _run(self, arm: Fr3Arm, trajectory: Trajectory) -> None:
        try:
            self.ended = arm.execute(trajectory)
        except DriverError as error:
            self.ended = error

    def end(self) -> Motion | DriverError | None:
        self._thread.join(timeout=60)
        return self.ended


def wait_until(holds: Callable[[], bool], patience_s: float = 60.0) -> None:
    give_up_s = time.monotonic() + patience_s
    while not holds():
        assert time.monotonic() < give_up_s
        time.sleep(0.002)


JOINED_S = 0.6
"""By then the difference between the robot's own start and the planned one has faded out (3 mrad take 0.59 s)."""
START_RAD = 3e-3


def test_a_whole_planned_pick_is_commanded_to_a_microradian_without_a_reflex(station: Station, arm: Fr3Arm) -> None:
    robot = Robot(station)
    scene = Scene.of(robot, station)
    home_q_rad = np.array(station.arm.capture_q_rad)
    assert arm.execute(move(scene, arm.state().q_rad, home_q_rad)).finished
    base_from_tcp = np.diag([1.0, -1.0, -1.0, 1.0])
    base_from_tcp[:3, 3] = 0.45, 0.05, 0.05
    grasp = Grasp(base_from_tcp=base_from_tcp, width_m=0.04, opening_m=0.06, score=1.0, rectangle=0,
                  imagined_base_from_tcp=base_from_tcp, terms={})  # fmt: skip
    for segment in plan_pick(scene, [grasp], home_q_rad).segments:
        motion = arm.execute(segment.trajectory)
        planned_q_rad = segment.trajectory.filtered()
        assert motion.finished, segment.name
        assert motion.commanded_q_rad.shape == planned_q_rad.shape
        off_rad = np.abs(motion.commanded_q_rad - planned_q_rad).max(axis=1)
        assert off_rad[0] < START_RAD and np.diff(off_rad).max() < 1e-6, "it begins where the robot is, and only nears"
        assert off_rad[round(JOINED_S / TICK_S) :].max() <= 1e-6, segment.name


def test_a_motion_planned_from_the_measured_position_ends_exactly_where_it_was_planned_to(arm: Fr3Arm) -> None:
    trajectory = nod(arm, by_rad=0.2, duration_s=2.0)
    shifted = trajectory.model_copy(update={"raw_q_rad": trajectory.raw_q_rad + 0.004})
    motion = arm.execute(shifted)
    assert np.abs(motion.commanded_q_rad[0] - shifted.start_q_rad).max() > 0.002, "it begins where the robot is"
    np.testing.assert_allclose(motion.commanded_q_rad[-1], shifted.end_q_rad, atol=1e-12)


def test_a_motion_that_starts_elsewhere_is_refused_and_nothing_moves(arm: Fr3Arm) -> None:
    before_q_rad = arm.state().q_rad
    elsewhere = nod(arm).model_copy(update={"raw_q_rad": nod(arm).raw_q_rad + 0.05})
    with pytest.raises(MotionRefused, match=r"0\.05\d rad from where joint \d"):
        arm.execute(elsewhere)
    assert np.abs(arm.state().q_rad - before_q_rad).max() < 2e-3
    assert arm.state().mode is ArmMode.IDLE


def test_a_stop_in_motion_comes_to_rest_within_half_a_second_without_a_reflex(arm: Fr3Arm) -> None:
    running = Running(arm)
    started_s = time.monotonic()
    arm.stop()
    motion = running.end()
    took_s = time.monotonic() - started_s
    assert isinstance(motion, Motion) and not motion.finished
    assert took_s < 0.5 and arm.state().mode is ArmMode.IDLE
    steps_rad = np.abs(np.diff(motion.commanded_q_rad[-3:], axis=0)).max()
    assert steps_rad < 1e-5, "the last commands stand still"


def test_a_reflex_is_named_and_after_recover_the_arm_moves_again(arm: Fr3Arm) -> None:
    step = nod(arm, by_rad=0.0, duration_s=0.5).raw_q_rad.copy()
    step[100:, 6] += np.deg2rad(1.0)
    with pytest.raises(ArmReflex, match="joint_motion_generator_velocity_discontinuity"):
        arm.execute(Trajectory(raw_q_rad=step, window=1))
    assert arm.state().mode is ArmMode.REFLEX
    with pytest.raises(MotionRefused, match=r"'reflex'.*cell clear"):
        arm.execute(nod(arm))
    arm.recover()
    assert arm.state().mode is ArmMode.IDLE
    assert arm.execute(nod(arm, by_rad=0.2, duration_s=2.0)).finished


def test_a_robot_that_dies_in_motion_is_missed_within_a_second_and_comes_back(arm: Fr3Arm, sim: FrankaSim) -> None:
    running = Running(arm)
    started_s = time.monotonic()
    sim.kill()
    error = running.end()
    assert isinstance(error, DeviceLost) and time.monotonic() - started_s < 1.0
    with pytest.raises(DeviceLost, match="does not answer"):
        arm.state()
    arm.stop()
    with pytest.raises(DriverUnavailable, match=r"fr3\.address|FCI"):
        arm.recover()
    sim.start()
    arm.recover()
    assert arm.state().mode is ArmMode.IDLE
    assert arm.execute(nod(arm, by_rad=0.2, duration_s=2.0)).finished


def test_closing_in_motion_brakes_it(arm: Fr3Arm) -> None:
    running = Running(arm)
    arm.close()
    motion = running.end()
    assert isinstance(motion, Motion) and not motion.finished


@pytest.mark.usefixtures("free")
def test_a_driver_that_is_frozen_in_motion_has_its_arm_at_rest_within_a_second() -> None:
    command = [sys.executable, "-m", "stand_ins.fr3_driver", "127.0.0.1"]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True) as driver:
        assert driver.stdout is not None
        assert driver.stdout.readline() == "moving\n"
        shared = shared_with(driver.pid)
        driver.send_signal(signal.SIGSTOP)
        frozen_s = time.monotonic()
        moving_q_d_rad = newest(shared).q_d_rad
        time.sleep(max(0.0, frozen_s + 1.0 - time.monotonic()))
        rests_q_d_rad = newest(shared).q_d_rad
        time.sleep(1.0)
        later_q_d_rad = newest(shared).q_d_rad
        driver.send_signal(signal.SIGCONT)
        assert driver.stdout.readline() == "finished False, idle\n"
        assert driver.stdout.readline() == "finished True, idle\n", "a new motion is played"
    assert np.array_equal(rests_q_d_rad, later_q_d_rad)
    assert np.abs(rests_q_d_rad - moving_q_d_rad).max() > 0.05, "it came to rest on its path"


def shared_with(pid: int) -> SharedState:
    """Return what the driver in another process shares with its control process."""
    folder = Path(f"/proc/{pid}/fd")
    path = next(entry for entry in folder.iterdir() if "fr3-state" in os.readlink(entry))
    return SharedState(os.open(path, os.O_RDWR))


def newest(shared: SharedState) -> RobotSnapshot:
    now = shared.read()
    assert now is not None
    return now


def test_it_reports_how_punctual_its_commands_were(arm: Fr3Arm) -> None:
    arm.execute(nod(arm, by_rad=0.2, duration_s=2.0))
    readings = arm.readings()
    assert 0.5 < readings["success_rate"] <= 1.0 and readings["lost_cycles"] >= 0
    arm.close()
    assert arm.readings() == {}


def test_an_address_without_a_robot_is_refused_with_what_to_do(station: Station) -> None:
    why = missing()
    if why is not None:
        pytest.skip(f"no FR3: {why}")
    nobody = station.model_copy(update={"fr3": Fr3Settings(address="127.0.0.9", realtime="ignore")})
    with pytest.raises(DriverUnavailable, match="activate FCI"):
        Fr3Arm(nobody).connect()


@pytest.mark.usefixtures("free")
@pytest.mark.skipif(_REALTIME_KERNEL.exists(), reason="this kernel is a real-time one")
def test_without_a_realtime_kernel_it_is_refused_where_one_is_required(station: Station) -> None:
    strict = station.model_copy(update={"fr3": Fr3Settings(address="127.0.0.1", realtime="enforce")})
    with pytest.raises(DriverUnavailable, match=r"PREEMPT_RT|real-time priority|Memory cannot be locked"):
        Fr3Arm(strict).connect()
