"""Each fault word does to each device what it says, at once and from any thread; and a stop always comes through."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from bus import topics
from bus.errors import BusError, DeviceLost, MotionRefused
from bus.fault_injection import Fault, FaultRequest
from bus.faulty_bus import FaultyBus
from bus.messages import ArmMode, Frame, HandState, Motion
from bus.session import Bus
from bus.trajectory import Trajectory
from config.load import load_station
from drivers.interface import Devices, Reporting
from drivers.node.fault_injection import (
    ABSURD_WIDTH_M,
    WRONG_JOINT_RAD,
    WRONG_WIDTH_M,
    FaultyArm,
    FaultyCamera,
    FaultyHand,
)
from drivers.node.guard import Guard
from drivers.node.node import Node
from drivers.node.registry import open_devices
from drivers.remote import RemoteArm, RemoteHand

DELAY_S = 0.2


class PicturedCamera:
    """A camera that numbers its frames."""

    def __init__(self, frame: Frame) -> None:
        self._frame, self._number = frame, 0

    def connect(self) -> None:
        pass

    def capture(self) -> Frame:
        self._number += 1
        return self._frame.model_copy(update={"stamp_ns": self._frame.stamp_ns + self._number})

    def readings(self) -> dict[str, float]:
        return {"temperature_c": 40.0}

    def close(self) -> None:
        pass


@pytest.fixture
def camera(frame: Frame) -> FaultyCamera:
    return FaultyCamera(PicturedCamera(frame), delay_s=DELAY_S)


@pytest.fixture(scope="module")
def simulated() -> Iterator[Devices]:
    devices = open_devices("sim", load_station())
    assert devices.arm is not None and devices.hand is not None
    devices.arm.connect()
    devices.hand.connect()
    yield devices
    devices.hand.close()
    devices.arm.close()


@pytest.fixture
def arm(simulated: Devices) -> FaultyArm:
    assert simulated.arm is not None
    return FaultyArm(simulated.arm, delay_s=DELAY_S)


@pytest.fixture
def hand(simulated: Devices) -> FaultyHand:
    assert simulated.hand is not None
    simulated.hand.move(0.05, 0.1)
    return FaultyHand(simulated.hand, delay_s=DELAY_S)


def nod(start_q_rad: np.ndarray, duration_s: float = 1.0) -> Trajectory:
    """Joint 7, 0.1 rad there and back."""
    phase = np.linspace(0.0, 1.0, round(duration_s * 1000))
    raw_q_rad = start_q_rad + 0.1 * ((0.5 - 0.5 * np.cos(2 * np.pi * phase)) ** 2)[:, None] * np.eye(7)[6]
    return Trajectory(raw_q_rad=raw_q_rad, window=64)


def lasting_s(act: Callable[[], object]) -> float:
    started_s = time.monotonic()
    act()
    return time.monotonic() - started_s


def shortest_s(act: Callable[[], object]) -> float:
    """Of three times: a busy machine is not late every time."""
    return min(lasting_s(act) for _ in range(3))


class Running:
    """``execute`` in a thread of its own, with what came of it."""

    def __init__(self, arm: FaultyArm, trajectory: Trajectory) -> None:
        self.motion: Motion | None = None
        self.error: Exception | None = None
        self._thread = threading.Thread(target=self._run, args=(arm, trajectory), daemon=True)
        self._thread.start()

    def _run(self, arm: FaultyArm, trajectory: Trajectory) -> None:
        try:
            self.motion = arm.execute(trajectory)
        except DeviceLost as error:
            self.error = error

    def ends_within(self, seconds: float) -> bool:
        self._thread.join(seconds)
        return not self._thread.is_alive()


def await_moving(arm: FaultyArm, start_q_rad: np.ndarray) -> None:
    give_up_s = time.monotonic() + 60
    while np.abs(arm.state().q_rad - start_q_rad).max() < 0.01:
        assert time.monotonic() < give_up_s


# --- the camera -------------------------------------------------------------------------------------------------------


def test_a_camera_that_is_off_is_lost_and_comes_back(camera: FaultyCamera) -> None:
    assert isinstance(camera, Reporting) and camera.readings() == {"temperature_c": 40.0}
    camera.fault = Fault.OFF
    for ask in (camera.connect, camera.capture):
        with pytest.raises(DeviceLost, match="camera"):
            ask()
    assert camera.readings() == {}
    camera.close()
    camera.fault = Fault.NONE
    camera.capture()


def test_a_stuck_camera_shows_its_last_frame_for_ever(camera: FaultyCamera) -> None:
    last = camera.capture()
    camera.fault = Fault.STUCK
    assert camera.capture() is last and camera.capture() is last
    camera.fault = Fault.NONE
    assert camera.capture().stamp_ns > last.stamp_ns


def test_a_garbling_camera_is_black_or_noise_and_without_depth(camera: FaultyCamera, frame: Frame) -> None:
    camera.fault = Fault.GARBAGE
    black, noise = camera.capture(), camera.capture()
    assert not black.color.any() and not black.depth_m.any()
    assert 70 < noise.color.std() < 78 and np.isnan(noise.depth_m).all()
    assert black.color.shape == noise.color.shape == frame.color.shape


def test_a_wrong_camera_mirrors(camera: FaultyCamera, frame: Frame) -> None:
    camera.fault = Fault.WRONG
    seen = camera.capture()
    np.testing.assert_array_equal(seen.color[:, 0], frame.color[:, -1])
    np.testing.assert_array_equal(seen.depth_m, frame.depth_m)


def test_a_slow_camera_is_late(camera: FaultyCamera) -> None:
    camera.fault = Fault.SLOW
    assert DELAY_S <= shortest_s(camera.capture) < 10 * DELAY_S


# --- the arm ----------------------------------------------------------------------------------------------------------


def test_an_arm_that_goes_off_brakes_and_is_lost_in_mid_motion(arm: FaultyArm, simulated: Devices) -> None:
    start_q_rad = arm.state().q_rad
    running = Running(arm, nod(start_q_rad, 30.0))
    await_moving(arm, start_q_rad)
    arm.fault = Fault.OFF
    assert running.ends_within(20) and isinstance(running.error, DeviceLost)
    for ask in (arm.connect, arm.state, arm.recover, arm.resume, lambda: arm.execute(nod(start_q_rad))):
        with pytest.raises(DeviceLost, match="arm"):
            ask()
    arm.stop()
    arm.hold()
    assert simulated.arm is not None and simulated.arm.state().mode is ArmMode.IDLE


def test_a_stuck_arm_repeats_its_state_and_executes_nothing_until_it_is_stopped(arm: FaultyArm) -> None:
    last = arm.state()
    arm.fault = Fault.STUCK
    running = Running(arm, nod(last.q_rad))
    assert not running.ends_within(0.1)
    assert arm.state() is last
    arm.stop()
    assert running.ends_within(60)
    assert running.motion is not None and not running.motion.finished and len(running.motion.t_s) == 1


@pytest.mark.parametrize("fault", [Fault.NONE, Fault.OFF])
def test_another_fault_ends_the_wait_of_a_stuck_arm(arm: FaultyArm, fault: Fault) -> None:
    arm.fault = Fault.STUCK
    running = Running(arm, nod(arm.state().q_rad))
    arm.fault = fault
    assert running.ends_within(60)
    assert (running.error is not None) == (fault is Fault.OFF)


def test_a_garbling_arm_says_nan_and_the_guard_lets_it_play_nothing(arm: FaultyArm) -> None:
    trajectory = nod(arm.state().q_rad)
    arm.fault = Fault.GARBAGE
    assert np.isnan(arm.state().q_rad).all() and np.isnan(arm.state().dq_rad_s).all()
    with pytest.raises(MotionRefused, match="not a finite number"):
        Guard(arm, load_station()).execute(trajectory)
    assert np.isnan(arm.execute(trajectory).q_rad).all(), "without a guard it moves, and measures nothing"


def test_a_wrong_arm_lives_in_joints_of_its_own(arm: FaultyArm, simulated: Devices) -> None:
    true_q_rad = arm.state().q_rad
    arm.fault = Fault.WRONG
    believed_q_rad = arm.state().q_rad
    np.testing.assert_allclose(believed_q_rad - true_q_rad, WRONG_JOINT_RAD, atol=1e-6)
    trajectory = nod(believed_q_rad)
    motion = arm.execute(trajectory)
    assert motion.finished
    np.testing.assert_allclose(motion.commanded_q_rad, trajectory.filtered(), atol=1e-9)
    np.testing.assert_allclose(motion.q_rad[0], believed_q_rad, atol=5e-3)
    assert simulated.arm is not None
    np.testing.assert_allclose(simulated.arm.state().q_rad, true_q_rad, atol=5e-3)


def test_a_slow_arm_answers_late_but_is_stopped_at_once(arm: FaultyArm, simulated: Devices) -> None:
    start_q_rad = arm.state().q_rad
    running = Running(arm, nod(start_q_rad, 30.0))
    await_moving(arm, start_q_rad)
    arm.delay_s, arm.fault = 0.5, Fault.SLOW
    stopping = threading.Thread(target=arm.stop)
    stopping.start()
    assert simulated.arm is not None
    give_up_s = time.monotonic() + 60
    while simulated.arm.state().mode is not ArmMode.IDLE:
        assert time.monotonic() < give_up_s
    assert running.ends_within(60) and running.motion is not None and not running.motion.finished
    stopping.join(60)
    assert lasting_s(arm.state) >= 0.5


# --- the hand ---------------------------------------------------------------------------------------------------------


def test_a_hand_that_is_off_is_lost(hand: FaultyHand) -> None:
    hand.fault = Fault.OFF
    for ask in (hand.connect, hand.state, hand.home, lambda: hand.move(0.02, 0.1), lambda: hand.grasp(30.0, 0.1)):
        with pytest.raises(DeviceLost, match="hand"):
            ask()
    hand.stop()


def test_a_stuck_hand_keeps_its_width(hand: FaultyHand) -> None:
    last = hand.state()
    hand.fault = Fault.STUCK
    asked: list[HandState] = [hand.move(0.02, 0.1), hand.grasp(30.0, 0.1), hand.home(), hand.state()]
    assert all(said is last for said in asked)
    hand.fault = Fault.NONE
    assert hand.state().width_m == pytest.approx(last.width_m, abs=1e-4), "its fingers never moved"


def test_a_garbling_hand_says_nan_and_five_metres(hand: FaultyHand) -> None:
    hand.fault = Fault.GARBAGE
    assert np.isnan(hand.state().width_m)
    assert hand.move(0.02, 0.1).width_m == ABSURD_WIDTH_M


def test_a_wrong_hand_is_a_centimetre_off(hand: FaultyHand) -> None:
    hand.fault = Fault.WRONG
    assert hand.move(0.03, 0.1).width_m == pytest.approx(0.03 + WRONG_WIDTH_M, abs=2e-3)


def test_a_slow_hand_is_late(hand: FaultyHand) -> None:
    hand.fault = Fault.SLOW
    assert DELAY_S <= shortest_s(hand.state) < 10 * DELAY_S


# --- over the bus -----------------------------------------------------------------------------------------------------


def test_faults_reach_the_daemon_through_the_node_as_what_they_are(endpoint: str) -> None:
    station = load_station()
    real = open_devices("sim", station)
    assert real.arm is not None and real.hand is not None
    arm, hand = FaultyArm(real.arm), FaultyHand(real.hand)
    with Bus.listen(station.cell_id, endpoint) as cell, Bus.join(station.cell_id, endpoint) as node_bus:
        node = Node("sim", node_bus, Devices(arm=arm, hand=hand), station)
        node.open()
        far_arm, far_hand = RemoteArm(cell, 5.0), RemoteHand(cell, 5.0)
        far_arm.connect()
        far_hand.connect()
        arm.fault = hand.fault = Fault.OFF
        for ask in (far_arm.state, far_hand.state):
            with pytest.raises(DeviceLost):
                ask()
        arm.fault = hand.fault = Fault.GARBAGE
        assert np.isnan(far_arm.state().q_rad).all()
        assert any(np.isnan(far_hand.state().width_m) for _ in range(20)), "NaN survives the wire"
        node.close()


def test_an_arm_whose_nodes_link_is_cut_stops_itself(endpoint: str) -> None:
    station = load_station(None, ["faults.allowed=true", "sim.pace=1"])
    real = open_devices("sim", station)
    assert real.arm is not None
    with Bus.listen(station.cell_id, endpoint) as cell, FaultyBus.join(station.cell_id, endpoint) as node_bus:
        node = Node("sim", node_bus, Devices(arm=real.arm), station)
        node.open()
        far_arm = RemoteArm(cell, 5.0)
        far_arm.connect()
        start_q_rad = far_arm.state().q_rad
        ended: queue.SimpleQueue[BusError] = queue.SimpleQueue()

        def execute() -> None:
            try:
                far_arm.execute(nod(start_q_rad, 60.0))
            except BusError as error:
                ended.put(error)

        threading.Thread(target=execute, daemon=True).start()
        give_up_s = time.monotonic() + 60
        while far_arm.state().mode is not ArmMode.MOVE:
            assert time.monotonic() < give_up_s
        cell.ask(topics.FAULT, FaultRequest(fault=Fault.OFF), timeout_s=60, part="bus")
        ended.get(timeout=60)
        while real.arm.state().mode is not ArmMode.IDLE:
            assert time.monotonic() < give_up_s
        node.close()
