"""Playing a trajectory: exact when undisturbed, on the path and within limits when braked."""

from __future__ import annotations

import numpy as np
import pytest

from bus.trajectory import Trajectory
from config.limits import FR3, check
from drivers.motion.stream import Stream

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


def play(trajectory: Trajectory, asked: dict[int, str] | None = None) -> tuple[np.ndarray, Stream]:
    """All commands; right before command number ``n`` the stream is asked to ``asked[n]``."""
    stream, asked = Stream(trajectory, FR3), dict(asked or {})
    commands: list[np.ndarray] = []
    while not (stream.held and not asked):
        if len(commands) in asked:
            getattr(stream, asked.pop(len(commands)))()
        command = stream.next()
        if command is None:
            break
        commands.append(command)
    return np.array(commands), stream


def next_of(stream: Stream) -> np.ndarray:
    """The next command of a stream that is not over."""
    command = stream.next()
    assert command is not None
    return command


def require_on_line_and_in_limits(commands: np.ndarray, what: object) -> None:
    assert check(commands).ok, (what, check(commands).describe())
    along = (commands - START) @ DIRECTION / (DIRECTION @ DIRECTION)
    assert np.abs(commands - START - along[:, None] * DIRECTION).max() < 1e-9
    assert (np.diff(along) > -1e-12).all(), "never backwards"


@pytest.mark.parametrize("window", [1, 16, 64])
def test_undisturbed_commands_are_the_filtered_trajectory(window: int) -> None:
    trajectory = line(window)
    commands, stream = play(trajectory)
    assert np.array_equal(commands, trajectory.filtered())
    assert stream.finished
    assert stream.next() is None


@pytest.mark.parametrize("window", [16, 64])
def test_a_brake_at_any_instant_keeps_every_limit_and_the_path(window: int) -> None:
    trajectory = line(window)
    for brake_at in range(1, len(trajectory.filtered()), 23):
        commands, stream = play(trajectory, {brake_at: "brake"})
        require_on_line_and_in_limits(commands, brake_at)
        assert stream.finished == np.array_equal(commands[-1], trajectory.filtered()[-1])


@pytest.mark.parametrize("window", [16, 64])
def test_held_and_resumed_at_any_instants_it_ends_at_the_end(window: int) -> None:
    trajectory = line(window)
    rng = np.random.default_rng(5)
    for _ in range(30):
        at = np.cumsum(rng.integers(1, 300, 6)).tolist()
        commands, stream = play(trajectory, dict(zip(at, ("hold", "resume") * 3, strict=True)))
        require_on_line_and_in_limits(commands, at)
        assert stream.finished
        assert np.array_equal(commands[-1], trajectory.filtered()[-1])


def test_held_it_gives_the_same_command_until_resumed() -> None:
    commands, stream = play(line(64), {400: "hold"})
    assert stream.held
    assert all(np.array_equal(next_of(stream), commands[-1]) for _ in range(50))
    stream.resume()
    assert not stream.held
    assert not np.array_equal(next_of(stream), next_of(stream))


def test_a_hold_costs_hardly_more_than_the_time_it_lasts() -> None:
    trajectory = line(64)
    commands, _ = play(trajectory, {400: "hold", 1400: "resume"})
    stopping_and_starting = len(commands) - len(trajectory.filtered()) - 1000
    assert stopping_and_starting < 250


@pytest.mark.parametrize("window", [16, 64])
def test_one_that_waits_rests_before_its_tick_until_it_is_resumed(window: int) -> None:
    whole = line(window)
    for waits_at in range(0, len(whole.filtered()), 37):
        waiting = whole.model_copy(update={"waits_at": waits_at})
        commands, stream = play(waiting)
        require_on_line_and_in_limits(commands, waits_at)
        passed = DIRECTION @ (commands[-1] - whole.filtered()[waits_at])
        assert stream.held and passed <= 1e-12, waits_at
        commands, stream = play(waiting, {len(commands) + 5: "resume"})
        require_on_line_and_in_limits(commands, waits_at)
        assert stream.finished


def test_one_that_is_resumed_in_time_does_not_wait() -> None:
    whole = line(64)
    commands, stream = play(whole.model_copy(update={"waits_at": 600}), {200: "resume"})
    assert stream.finished and np.array_equal(commands, whole.filtered())


def test_one_that_waits_and_is_held_goes_on_when_it_is_resumed() -> None:
    """There is one way on; who resumes knows that nothing is to be waited for (`cell.pick.opening`)."""
    waiting = line(64).model_copy(update={"waits_at": 600})
    commands, stream = play(waiting, {100: "hold", 700: "resume"})
    require_on_line_and_in_limits(commands, 600)
    assert stream.finished


def test_nothing_resumes_after_a_brake() -> None:
    commands, stream = play(line(64), {300: "hold", 900: "brake", 901: "resume"})
    assert len(commands) == 900
    assert not stream.finished
    assert stream.next() is None


def test_a_brake_stops_soon() -> None:
    commands, _ = play(line(64), {400: "brake"})
    assert len(commands) - 400 < 1.5 / 9.8 * 1000 + 64 + 20


def test_a_brake_before_the_first_command_does_not_move() -> None:
    commands, stream = play(line(16), {0: "brake"})
    assert (commands == START).all()
    assert not stream.finished


def test_a_brake_after_the_last_command_changes_nothing() -> None:
    trajectory = line(64)
    commands, stream = play(trajectory, {len(trajectory.filtered()): "brake"})
    assert np.array_equal(commands, trajectory.filtered())
    assert stream.finished


def test_a_trajectory_of_one_sample_gives_its_window_and_ends() -> None:
    trajectory = Trajectory(raw_q_rad=START[None], window=5)
    commands, stream = play(trajectory)
    assert np.array_equal(commands, np.tile(START, (5, 1)))
    assert stream.finished
