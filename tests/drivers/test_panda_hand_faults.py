"""The Franka hand's driver over a package that says what a test wants: odd answers, and stops at odd moments."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace

import pytest

from bus.errors import DeviceLost, HandFault
from bus.threads import handled_by
from config.hardware import PandaHandSettings
from config.load import load_station
from drivers.panda_hand.hand import PandaHand
from stand_ins.franky import FakeHand, FrankyError, NetworkError

STATION = load_station().model_copy(update={"panda_hand": PandaHandSettings(poll_s=0.005)})


@contextmanager
def connected(fake: FakeHand, utc_ns: Callable[[], int] = time.time_ns) -> Iterator[PandaHand]:
    hand = PandaHand(STATION, fake.package, utc_ns)
    hand.connect()
    try:
        yield hand
    finally:
        hand.close()


def until(holds: Callable[[], bool], patience_s: float = 60.0) -> None:
    give_up_s = time.monotonic() + patience_s
    while not holds():
        assert time.monotonic() < give_up_s
        time.sleep(0.002)


def saying(what: object) -> Callable[[FakeHand], object]:
    """An answer that is always ``what``, raised if it is an error."""

    def answer(_: FakeHand) -> object:
        if isinstance(what, Exception):
            raise what
        return what

    return answer


ODD = [
    FrankyError("libfranka gripper: command failed"),
    NetworkError("connection reset"),
    RuntimeError("Net Exception"),
    SimpleNamespace(width=math.nan, max_width=0.08),
    SimpleNamespace(width=None, max_width=0.08),
    SimpleNamespace(width=0.04, max_width="wide"),
    SimpleNamespace(),
    None,
]


@pytest.mark.parametrize("odd", ODD, ids=repr)
def test_whatever_it_answers_once_it_is_asked_again_and_the_refusal_is_counted(odd: object) -> None:
    fake = FakeHand()
    with connected(fake) as hand:
        usual, fake.answers = fake.answers, saying(odd)
        until(lambda: hand.readings()["refusals"] >= 1)
        fake.answers = usual
        told_ns = time.time_ns()
        until(lambda: hand.readings()["width_age_s"] < 0.5 and hand.state().stamp_ns > told_ns)
        assert hand.state().width_m == 0.04


def test_a_grasp_after_which_the_width_is_refused_once_is_a_grasp() -> None:
    fake = FakeHand()
    usual = fake.answers

    def refuse_once(hand: FakeHand) -> object:
        hand.answers = usual
        raise FrankyError("libfranka gripper: command failed")

    def begin_to_refuse() -> None:
        fake.answers = refuse_once

    with connected(fake) as hand:
        fake.during = begin_to_refuse
        assert hand.grasp(30.0, 0.1).width_m == 0.0


def test_a_hand_that_only_refuses_is_lost_after_a_second_says_why_and_is_connected_anew() -> None:
    fake = FakeHand()
    with connected(fake) as hand:
        usual, fake.answers = fake.answers, saying(FrankyError("libfranka gripper: command failed"))
        until(lambda: hand.readings()["width_age_s"] > 1.0)
        with pytest.raises(DeviceLost, match="command failed"):
            hand.state()
        until(lambda: fake.connections >= 2)
        fake.answers = usual
        until(lambda: hand.readings()["width_age_s"] < 0.5)
        assert hand.state().width_m == 0.04 and not hand.state().is_homed
        assert hand.readings()["reconnects"] >= 1


def test_a_connection_that_is_refused_by_any_error_is_tried_again() -> None:
    fake = FakeHand()
    with connected(fake) as hand:
        usual, fake.answers, fake.refusing = fake.answers, saying(NetworkError("gone")), RuntimeError("Net Exception")
        until(lambda: hand._trouble.startswith("The Franka hand at"))
        fake.answers, fake.refusing = usual, None
        until(lambda: hand.readings()["reconnects"] >= 1)
        until(lambda: hand.readings()["width_age_s"] < 0.5)


def test_an_unforeseen_error_is_told_and_the_hand_is_lost_until_it_is_connected_again() -> None:
    fake, told = FakeHand(), []
    with handled_by(lambda name, defect: told.append((name, repr(defect)))), connected(fake) as hand:
        usual, fake.answers = fake.answers, saying(KeyError("unforeseen"))
        until(lambda: bool(told))
        assert told == [("hand-poll", "KeyError('unforeseen')")]
        until(lambda: is_lost(hand))
        fake.answers = usual
        hand.connect()
        assert hand.state().width_m == 0.04


def is_lost(hand: PandaHand) -> bool:
    try:
        hand.state()
    except DeviceLost:
        return True
    return False


def test_a_step_of_the_wall_clock_loses_no_hand_and_shows_only_in_its_stamps() -> None:
    step_ns = [0]
    fake = FakeHand()
    with connected(fake, lambda: time.time_ns() + step_ns[0]) as hand:
        for hours in (-2, 3):
            step_ns[0] = hours * 3_600_000_000_000
            until(lambda: abs(hand.state().stamp_ns - time.time_ns() - step_ns[0]) < 60e9)


def test_a_stop_between_the_question_and_the_motion_wins() -> None:
    fake = FakeHand()
    with connected(fake) as hand:

        class Hesitant(float):
            """A speed that is looked at only after somebody stopped the hand."""

            def __truediv__(self, other: float) -> float:
                hand.stop()
                return float(self) / other

        hand.move(0.02, Hesitant(0.1))
        hand.grasp(30.0, Hesitant(0.1))
        assert fake.asked == [] and hand.state().width_m == 0.04
        hand.move(0.02, 0.1)
        assert fake.asked == ["move"], "a motion asked for after a stop runs"


def test_a_stop_is_said_again_to_a_hand_that_had_not_begun() -> None:
    fake = FakeHand(deaf_stops=1, done=False)
    begun = threading.Event()

    def wait_for_a_stop() -> None:
        begun.set()
        assert fake.stopped.wait(60)

    fake.during = wait_for_a_stop
    with connected(fake) as hand:
        mover = threading.Thread(target=lambda: hand.move(0.02, 0.1))
        mover.start()
        assert begun.wait(60)
        hand.stop()
        mover.join(60)
        assert fake.asked == ["move", "stop", "stop"] and not hand.state().is_moving


@pytest.mark.parametrize("error", [FrankyError("command aborted"), None])
def test_a_stopped_homing_does_not_count_and_is_no_fault(error: Exception | None) -> None:
    fake = FakeHand(done=False)
    with connected(fake) as hand:

        def stop_it() -> None:
            hand.stop()
            if error is not None:
                raise error

        fake.during = stop_it
        assert not hand.home().is_homed and not hand.state().is_moving


def test_a_grasp_is_never_stopped_and_a_refused_one_is_a_fault() -> None:
    fake = FakeHand()
    with connected(fake) as hand:
        fake.during = hand.stop
        hand.grasp(30.0, 0.1)
        assert fake.asked == ["grasp"]
        fake.during = lambda: saying(FrankyError("command aborted"))(fake)
        with pytest.raises(HandFault, match="aborted"):
            hand.grasp(30.0, 0.1)
        assert not hand.state().is_moving
