"""The guard refuses by kind, moves nothing when it does, and never stands in the way of a stop."""

from __future__ import annotations

import numpy as np
import pytest

from bus.errors import HandFault, MotionRefused, NotConnected
from bus.messages import ArmMode, ArmState, Motion
from bus.trajectory import Trajectory
from config.devices import NodeSettings
from config.limits import UPPER_RAD
from config.schema import Station
from drivers.interface import Arm
from drivers.node.guard import Guard, HandGuard
from drivers.sim.hand import SimHand
from drivers.sim.world import World

HOME = np.array([0.0, -0.55, 0.0, -2.1, 0.0, 1.55, 0.785])
STATION = Station(nodes={"sim": NodeSettings(driver="sim", serves=("camera", "arm", "hand"))})


class RecordingArm:
    """An arm that stands still and notes what it is asked."""

    def __init__(self, q_rad: np.ndarray = HOME, mode: ArmMode = ArmMode.IDLE) -> None:
        self.q_rad, self.mode = q_rad, mode
        self.asked: list[str] = []
        self.played: list[Trajectory] = []

    def connect(self) -> None:
        self.asked.append("connect")

    def state(self) -> ArmState:
        zero = np.zeros(7)
        return ArmState(stamp_ns=0, mode=self.mode, q_rad=self.q_rad, dq_rad_s=zero, tau_ext_nm=zero)

    def execute(self, trajectory: Trajectory) -> Motion:
        self.played.append(trajectory)
        q, t = trajectory.filtered(), np.zeros(1)
        return Motion(finished=True, commanded_q_rad=q, t_s=t, q_rad=q[:1], dq_rad_s=q[:1] * 0, tau_ext_nm=q[:1] * 0)

    def stop(self) -> None:
        self.asked.append("stop")

    def hold(self) -> None:
        self.asked.append("hold")

    def resume(self) -> None:
        self.asked.append("resume")

    def recover(self) -> None:
        self.asked.append("recover")

    def close(self) -> None:
        self.asked.append("close")


class DeadArm(RecordingArm):
    def stop(self) -> None:
        raise NotConnected("The arm is not connected.")

    def hold(self) -> None:
        raise NotConnected("The arm is not connected.")


def gentle(q_rad: np.ndarray = HOME, window: int = 64) -> Trajectory:
    """A smooth move of joint 1 by 0.1 rad in 0.5 s."""
    s = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 501))
    return Trajectory(raw_q_rad=q_rad + 0.1 * s[:, None] * np.eye(7)[0], window=window)


def refusal(arm: RecordingArm, trajectory: Trajectory) -> str:
    with pytest.raises(MotionRefused) as caught:
        Guard(arm, STATION).execute(trajectory)
    assert arm.played == [], "nothing moved"
    assert caught.value.advice
    return caught.value.text


def test_the_guard_is_an_arm() -> None:
    assert isinstance(Guard(RecordingArm(), STATION), Arm)


def test_a_good_motion_is_played_unchanged() -> None:
    arm, trajectory = RecordingArm(), gentle()
    assert Guard(arm, STATION).execute(trajectory).finished
    assert arm.played == [trajectory]
    assert arm.played[0] is trajectory


def test_a_jump_is_refused_with_kind_joint_and_time() -> None:
    raw = np.tile(HOME, (20, 1))
    raw[10:, 2] += 0.1
    assert "jerk of joint 3 at 0.010 s is over" in refusal(RecordingArm(), Trajectory(raw_q_rad=raw, window=64))


def test_too_much_jerk_is_refused() -> None:
    assert "jerk of joint 1" in refusal(RecordingArm(), Trajectory(raw_q_rad=hard_line(), window=1))


def hard_line() -> np.ndarray:
    """Joint 1 at +-9.9 rad/s^2: within the acceleration limit, and far over the jerk limit without a filter."""
    velocity = np.cumsum(np.repeat([9.9, -9.9], 100)) * 1e-3
    q_rad: np.ndarray = HOME + np.cumsum(velocity)[:, None] * 1e-3 * np.eye(7)[0]
    return q_rad


def test_too_much_acceleration_is_refused() -> None:
    s = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 501))
    raw = HOME + 0.6 * s[:, None] * np.eye(7)[6]
    assert "acceleration of joint 7" in refusal(RecordingArm(), Trajectory(raw_q_rad=raw, window=64))


def test_too_fast_is_refused() -> None:
    s = np.cumsum(np.cumsum(np.concatenate([np.full(300, 9.5), np.full(300, -9.5)]))) * 1e-6
    q = HOME - s[:, None] * np.eye(7)[0]
    assert "velocity of joint 1" in refusal(RecordingArm(), Trajectory(raw_q_rad=q, window=64))


def test_leaving_the_joint_range_is_refused() -> None:
    q = HOME.copy()
    q[5] = UPPER_RAD[5] + 0.01
    assert "position of joint 6" in refusal(RecordingArm(q), Trajectory(raw_q_rad=q[None], window=1))


def test_not_finite_is_refused() -> None:
    bad = gentle().raw_q_rad.copy()
    bad[7, 3] = np.nan
    assert "not a finite number" in refusal(RecordingArm(), Trajectory.model_construct(raw_q_rad=bad, window=64))


def test_a_start_elsewhere_is_refused_with_the_joint() -> None:
    away = HOME + 0.03 * np.eye(7)[4]
    assert "0.030 rad away from where joint 5 is" in refusal(RecordingArm(away), gentle())


def test_a_start_within_the_tolerance_is_allowed() -> None:
    arm = RecordingArm(HOME + 0.015)
    Guard(arm, STATION).execute(gentle())
    assert len(arm.played) == 1


def test_an_unknown_measured_position_is_refused() -> None:
    assert "not a finite number" in refusal(RecordingArm(HOME * np.nan), gentle())


@pytest.mark.parametrize("mode", [m for m in ArmMode if m is not ArmMode.IDLE])
def test_an_arm_that_is_not_idle_is_refused(mode: ArmMode) -> None:
    assert f"reports {mode.value}" in refusal(RecordingArm(mode=mode), gentle())


def test_everything_else_passes_straight_through() -> None:
    arm = RecordingArm()
    guard = Guard(arm, STATION)
    guard.connect()
    guard.stop()
    guard.hold()
    guard.resume()
    guard.recover()
    guard.close()
    assert arm.asked == ["connect", "stop", "hold", "resume", "recover", "close"]
    assert guard.state().mode is ArmMode.IDLE


def test_a_stop_and_a_hold_never_raise() -> None:
    Guard(DeadArm(), STATION).stop()
    Guard(DeadArm(), STATION).hold()


# --- the hand ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("verb", "first", "speed_m_s"),
    [
        ("move", 0.2, 0.05), ("move", -0.01, 0.05), ("move", float("nan"), 0.05), ("move", 0.04, 5.0),
        ("grasp", 300.0, 0.05), ("grasp", float("nan"), 0.05), ("grasp", 30.0, float("inf")),
    ],
)  # fmt: skip
def test_a_hand_is_not_asked_for_what_it_cannot_do(verb: str, first: float, speed_m_s: float) -> None:
    hand = SimHand(World(STATION))
    hand.connect()
    guarded = HandGuard(hand, STATION)
    before_m = guarded.state().width_m
    with pytest.raises(HandFault, match="is not between"):
        getattr(guarded, verb)(first, speed_m_s)
    assert guarded.state().width_m == before_m
    assert guarded.move(0.05, 0.1).width_m == pytest.approx(0.05, abs=1e-3)
