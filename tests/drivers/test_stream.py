"""Playing a trajectory: exact when undisturbed, on the path and within limits when braked."""

from __future__ import annotations

import numpy as np
import pytest

from bus.trajectory import Trajectory
from config.limits import check
from drivers.stream import Stream

START = np.array([0.0, -0.55, 0.0, -2.1, 0.0, 1.55, 0.785])
DIRECTION = np.array([1.0, 0.5, -0.7, 0.3, -0.2, 0.8, -1.0])


def line(window: int, distance_rad: float = 1.0, speed: float = 1.5, acceleration: float = 9.8) -> Trajectory:
    """A straight joint line with the hardest profile there is: full acceleration, cruise, full braking."""
    ramp_s, cruise_s = speed / acceleration, distance_rad / speed - speed / acceleration
    t = np.arange(0.0, 2 * ramp_s + cruise_s + 1e-3, 1e-3)
    left = np.maximum(0.0, 2 * ramp_s + cruise_s - t)
    middle = acceleration * ramp_s**2 / 2 + speed * (t - ramp_s)
    s = np.select(
        [t < ramp_s, t < ramp_s + cruise_s],
        [acceleration * t**2 / 2, middle],
        distance_rad - acceleration * left**2 / 2,
    )
    return Trajectory(raw_q_rad=START + s[:, None] * DIRECTION, window=window)


def play(trajectory: Trajectory, brake_at: int | None = None) -> tuple[np.ndarray, Stream]:
    """All commands, with a brake right before command number ``brake_at``."""
    stream, commands = Stream(trajectory), []
    while True:
        if len(commands) == brake_at:
            stream.brake()
        command = stream.next()
        if command is None:
            return np.array(commands), stream
        commands.append(command)


@pytest.mark.parametrize("window", [1, 4, 64])
def test_undisturbed_commands_are_the_filtered_trajectory(window: int) -> None:
    trajectory = line(window)
    commands, stream = play(trajectory)
    assert commands.shape == trajectory.filtered().shape
    assert np.abs(commands - trajectory.filtered()).max() < 1e-12
    assert stream.finished
    assert stream.next() is None


@pytest.mark.parametrize("window", [4, 64])
def test_a_brake_at_any_instant_keeps_every_limit_and_the_path(window: int) -> None:
    trajectory = line(window)
    for brake_at in range(0, len(trajectory.raw_q_rad), 23):
        commands, stream = play(trajectory, brake_at)
        assert check(commands).ok, (brake_at, check(commands).describe())
        along = (commands - START) @ DIRECTION / (DIRECTION @ DIRECTION)
        assert np.abs(commands - START - along[:, None] * DIRECTION).max() < 1e-9
        assert (np.diff(along) > -1e-6).all(), "a brake never runs backwards"
        assert not stream.finished


def test_a_brake_stops_soon() -> None:
    trajectory = line(64)
    commands, _ = play(trajectory, 400)
    assert len(commands) - 400 < 1.5 / 9.8 * 1000 + 64 + 20


def test_a_brake_before_the_first_command_hardly_moves() -> None:
    commands, stream = play(line(4), 0)
    assert np.abs(commands - START).max() < 1e-3
    assert not stream.finished


def test_a_brake_after_the_last_raw_sample_changes_nothing() -> None:
    trajectory = line(64)
    commands, stream = play(trajectory, len(trajectory.raw_q_rad) + 10)
    assert np.array_equal(commands, play(trajectory)[0])
    assert stream.finished


def test_a_braked_stream_ends_at_rest() -> None:
    commands, _ = play(line(8), 300)
    assert np.abs(commands[-1] - commands[-2]).max() < 1e-6


def test_a_trajectory_of_one_sample_gives_its_window_and_ends() -> None:
    trajectory = Trajectory(raw_q_rad=START[None], window=5)
    commands, stream = play(trajectory)
    assert np.array_equal(commands, np.tile(START, (5, 1)))
    assert stream.finished
