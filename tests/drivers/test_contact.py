"""A guarded motion that meets something brakes on its path by itself; on the simulated arm, softly."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from benchmarks.contact import Bench, place_post
from bus.trajectory import ContactGuard, Trajectory
from config.limits import FR3, check
from drivers.motion.stream import Stream
from drivers.sim.moved import raise_table

START_RAD = np.array([0.0, -0.55, 0.0, -2.1, 0.0, 1.55, 0.785])
GUARD = ContactGuard(begins_at=500, limit_n=5.0, force_from_torque=np.eye(7)[:1])
"""The force against the motion is the first joint's torque, in N for Nm."""


def turn(duration_s: float, guard: ContactGuard | None = GUARD) -> Trajectory:
    """All joints by 0.3 rad, from rest to rest."""
    ticks = round(duration_s * 1000)
    share = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, ticks))
    return Trajectory(raw_q_rad=START_RAD + 0.3 * share[:, None], window=64, guard=guard)


def play(
    trajectory: Trajectory, torque_nm: dict[int, float], asked: dict[int, str] | None = None
) -> tuple[np.ndarray, Stream]:
    """All commands, and the stream. From command number ``n`` on joint 1 feels ``torque_nm[n]``; as in test_stream."""
    stream, asked, now_nm = Stream(trajectory, FR3), dict(asked or {}), 0.0
    commands: list[np.ndarray] = []
    while not (stream.held and not asked):
        if len(commands) in asked:
            getattr(stream, asked.pop(len(commands)))()
        command = stream.next()
        if command is None:
            break
        now_nm = torque_nm.get(len(commands), now_nm)
        commands.append(command)
        if stream.is_felt:
            stream.feel(now_nm * np.eye(7)[0])
    return np.array(commands), stream


def test_what_is_no_more_than_the_limit_above_what_it_was_is_no_contact() -> None:
    commands, stream = play(turn(1.5), {0: 20.0, 700: 24.9})
    assert stream.finished and stream.contact_n is None
    np.testing.assert_array_equal(commands, turn(1.5).filtered())


def test_a_contact_before_the_guard_begins_is_not_felt() -> None:
    assert play(turn(1.5), {200: 50.0})[1].finished


def test_a_single_sample_is_noise() -> None:
    assert play(turn(1.5), {700: 50.0, 701: 0.0, 900: -50.0})[1].finished


@pytest.mark.parametrize("duration_s", [1.0, 3.0, 12.0])
def test_at_a_contact_it_brakes_on_its_path_and_goes_back_to_just_before(duration_s: float) -> None:
    ticks = round(1000 * duration_s)
    for touched_at in (*range(510, ticks, round(97 * duration_s**2)), ticks + 50, ticks + 58, ticks + 60):
        commands, stream = play(turn(duration_s), {touched_at: 6.0})
        assert stream.contact_n == pytest.approx(6.0) and not stream.finished
        report = check(commands)
        assert report.ok, (touched_at, report.describe())
        away_rad = commands - START_RAD
        assert np.abs(away_rad - away_rad[:, :1]).max() < 1e-9, "it leaves the path"
        assert commands[-1, 0] < commands[touched_at, 0], "it goes on pressing"
        np.testing.assert_allclose(commands[-1], commands[-2], atol=1e-5)


def test_a_slow_motion_brakes_within_hundredths_of_a_second() -> None:
    commands, _ = play(turn(12.0), {6000: 6.0})
    assert commands[:, 0].argmax() - 6000 < 30


@pytest.mark.parametrize("ending", ["resume", "brake"])
def test_while_it_is_held_it_feels_nothing_and_holds_as_ever(ending: str) -> None:
    commands, stream = play(turn(2.0), {900: 50.0, 1400: 0.0}, {890: "hold", 1500: ending})
    assert stream.contact_n is None and stream.finished == (ending == "resume")
    assert (np.diff(commands[:, 0]) >= -1e-12).all(), "it goes back, though it met nothing"


def test_after_a_hold_it_feels_again() -> None:
    stream = play(turn(2.0), {1600: 50.0}, {890: "hold", 1500: "resume"})[1]
    assert stream.contact_n == pytest.approx(50.0)


def test_a_stop_is_a_stop_whatever_is_felt_then() -> None:
    commands, stream = play(turn(2.0), {1001: 50.0}, {1000: "brake"})
    assert stream.contact_n is None and (np.diff(commands[:, 0]) >= -1e-12).all()


@pytest.mark.parametrize("wrong", [{"limit_n": 0.0}, {"force_from_torque": np.zeros((0, 7))},
                                   {"force_from_torque": np.full((1, 7), np.nan)}])  # fmt: skip
def test_a_guard_that_could_never_be_judged_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        ContactGuard.model_validate({"begins_at": 0, "limit_n": 5.0, "force_from_torque": np.zeros((1, 7)), **wrong})


# --- the simulated arm ------------------------------------------------------------------------------------------------

PLACES = ((0.45, 0.05, 0.3), (0.36, -0.1, 1.2), (0.56, 0.15, -0.7))


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench()


@pytest.mark.parametrize("speed", [0.3, 1.0])
def test_free_descents_with_all_their_accelerations_are_no_contact(bench: Bench, speed: float) -> None:
    raise_table(bench.world, 0.0)
    for place in PLACES:
        motion, felt = bench.play(bench.descent(*place, speed=speed))
        assert motion is not None and motion.finished and motion.contact_n is None and felt.peak_n == 0.0


@pytest.mark.parametrize("by_mm", [5.0, 10.0])
def test_a_table_higher_than_believed_is_touched_softly_and_no_longer_pressed(bench: Bench, by_mm: float) -> None:
    raise_table(bench.world, by_mm / 1e3)
    for place in PLACES:
        motion, felt = bench.play(bench.descent(*place))
        assert motion is not None and not motion.finished and motion.contact_n is not None, "a reflex, or unnoticed"
        assert felt.peak_n < 20.0 and felt.overshoot_mm < 3.0, (felt.peak_n, felt.overshoot_mm)
        assert felt.force_n[-1] < 5.0


def test_a_hidden_post_under_the_palm_is_felt_too(bench: Bench) -> None:
    raise_table(bench.world, 0.0)
    reach = bench.descent(*PLACES[0])
    place_post(bench.world, bench.robot, reach, 7.0)
    motion, felt = bench.play(reach)
    place_post(bench.world, bench.robot, reach, -500.0)
    assert motion is not None and motion.contact_n is not None and felt.peak_n < 20.0


def test_with_nothing_to_feel_it_is_a_reflex() -> None:
    numb = Bench(["execute.contact_n=0"])
    raise_table(numb.world, 0.010)
    reach = numb.descent(*PLACES[0])
    assert reach.guard is None and numb.play(reach)[0] is None
