"""libfranka's words, as errors of ours: the robot's own names stay, and each says what to do."""

from __future__ import annotations

import pytest

from bus.errors import ArmReflex, DeviceLost, DriverError, DriverUnavailable, MotionRefused
from bus.messages import ArmMode
from bus.remote_errors import error_from_reply, error_reply
from drivers.fr3.errors import advice_of_mode, arm_mode, connect_error, motion_error


def raised(kind: str, text: str) -> Exception:
    """An exception as pylibfranka's are told apart: by the name of their class."""
    error: Exception = type(kind, (RuntimeError,), {})(text)
    return error


REFLEX = 'libfranka: Move command aborted: motion aborted by reflex! ["{}"]\ncontrol_command_success_rate: 0.99'


@pytest.mark.parametrize(
    ("name", "advice"),
    [
        ("communication_constraints_violation", "PREEMPT_RT"),
        ("joint_motion_generator_velocity_discontinuity", "came late"),
        ("joint_position_limits_violation", "came to its end"),
        ("self_collision_avoidance_violation", "touched itself"),
        ("joint_reflex", "collision_torque_nm"),
        ("cartesian_reflex", "fr3.load"),
        ("tau_j_range_violation", "fr3.load"),
        ("power_limit_violation", "arm.speed"),
    ],
)
def test_a_reflex_keeps_the_robot_s_name_and_says_what_to_do(name: str, advice: str) -> None:
    error = motion_error(raised("ControlException", REFLEX.format(name)))
    assert isinstance(error, ArmReflex) and name in error.text
    assert advice in error.advice and "cell clear" in error.advice


def test_several_names_are_all_kept() -> None:
    error = motion_error(raised("ControlException", REFLEX.format('joint_reflex", "cartesian_reflex')))
    assert "joint_reflex, cartesian_reflex" in error.text


@pytest.mark.parametrize(
    ("kind", "text", "expected", "words"),
    [
        ("NetworkException", "libfranka: UDP receive: Timeout", DeviceLost, "Timeout"),
        ("CommandException", 'command not possible in the current mode ("User stopped")!', MotionRefused, "user stop"),
        ("CommandException", 'command not possible in the current mode ("Guiding")!', MotionRefused, "guiding button"),
        ("ControlException", "libfranka: something new", ArmReflex, "something new"),
        ("InvalidOperationException", "another control", DriverError, "another control"),
    ],
)
def test_every_other_fault_has_its_type(kind: str, text: str, expected: type[Exception], words: str) -> None:
    error = motion_error(raised(kind, text))
    assert type(error) is expected and words in str(error)


@pytest.mark.parametrize(
    ("kind", "text", "words", "exit_code"),
    [  # a service starts again after exit code 1: the robot may be switched on later
        ("RealtimeException", "Running kernel does not have realtime capabilities", "PREEMPT_RT", 2),
        ("NetworkException", "Connection to FCI refused", "activate FCI", 1),
        ("IncompatibleVersionException", "Incompatible library version", "system image", 2),
        ("NetworkException", "No route to host", "fr3.address", 1),
    ],
)
def test_what_keeps_it_from_connecting_says_what_to_do(kind: str, text: str, words: str, exit_code: int) -> None:
    error = connect_error(raised(kind, text), "172.16.0.2")
    assert isinstance(error, DriverUnavailable) and words in error.advice and "172.16.0.2" in error.text
    assert error.exit_code == exit_code and error_from_reply(error_reply(error)).exit_code == exit_code


def test_modes() -> None:
    assert [arm_mode(number) for number in (1, 2, 4, 5)] == [
        ArmMode.IDLE, ArmMode.MOVE, ArmMode.REFLEX, ArmMode.USER_STOPPED,
    ]  # fmt: skip
    assert arm_mode(3) is arm_mode(0) is ArmMode.OTHER
    assert all(advice_of_mode(number) for number in (0, 3, 4, 5, 6)) and advice_of_mode(1) == ""
