"""The Franka hand's driver against the strict simulator's hand."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

import pytest

from bus.errors import DeviceLost, DriverUnavailable, HandFault
from config.hardware import PandaHandSettings
from config.load import load_station
from drivers.panda_hand.hand import PandaHand
from stand_ins.franka import ADDRESS, FrankaSim, missing

pytestmark = pytest.mark.xdist_group("franka")  # its ports are fixed: one simulator at a time
OBJECT_M = 0.04
STATION = load_station().model_copy(update={"panda_hand": PandaHandSettings(address=ADDRESS)})


@pytest.fixture(scope="module")
def sim() -> Iterator[FrankaSim]:
    why = missing()
    if why is not None:
        pytest.skip(f"no hand: {why}")
    with FrankaSim(object_width_m=OBJECT_M) as sim:
        yield sim


@pytest.fixture
def hand(sim: FrankaSim) -> Iterator[PandaHand]:
    hand = PandaHand(STATION)
    hand.connect()
    hand.home()
    yield hand
    hand.close()


def until(holds: Callable[[], bool], patience_s: float = 60.0) -> None:
    give_up_s = time.monotonic() + patience_s
    while not holds():
        assert time.monotonic() < give_up_s
        time.sleep(0.02)


def is_lost(hand: PandaHand) -> bool:
    try:
        hand.state()
    except DeviceLost:
        return True
    return False


def test_it_closes_on_whatever_is_there_without_being_told_how_wide_it_is(hand: PandaHand) -> None:
    assert hand.grasp(30.0, 0.1).width_m == pytest.approx(OBJECT_M, abs=1e-3)


def test_a_stop_never_lets_go_of_what_is_held(hand: PandaHand) -> None:
    hand.grasp(30.0, 0.1)
    hand.stop()  # this simulator's fingers would open fully
    time.sleep(0.3)
    assert hand.state().width_m == pytest.approx(OBJECT_M, abs=1e-3)


def test_a_stop_during_a_grasp_lets_it_finish(hand: PandaHand) -> None:
    ended: list[float] = []
    runner = threading.Thread(target=lambda: ended.append(hand.grasp(30.0, 0.1).width_m))
    runner.start()
    until(lambda: hand.state().is_moving or bool(ended))
    hand.stop()
    runner.join(60)
    assert ended == [pytest.approx(OBJECT_M, abs=1e-3)]


def test_before_homing_it_says_so(sim: FrankaSim) -> None:
    hand = PandaHand(STATION)
    hand.connect()
    assert not hand.state().is_homed
    assert hand.home().is_homed
    hand.close()


@pytest.mark.parametrize(("force_n", "speed_m_s"), [(0.0, 0.1), (float("nan"), 0.1), (30.0, 0.0)])
def test_an_impossible_grasp_is_refused(hand: PandaHand, force_n: float, speed_m_s: float) -> None:
    with pytest.raises(HandFault, match="positive"):
        hand.grasp(force_n, speed_m_s)


def test_a_hand_that_goes_away_is_missed_and_found_again(hand: PandaHand, sim: FrankaSim) -> None:
    sim.kill()
    until(lambda: is_lost(hand))
    with pytest.raises(DeviceLost, match="cell clear"):
        hand.move(0.05, 0.1)
    hand.stop()
    sim.start()
    until(lambda: not is_lost(hand))
    assert not hand.state().is_homed, "it may have been switched off"
    assert hand.home().is_homed


def test_nobody_at_the_address_is_said_with_what_to_do(sim: FrankaSim) -> None:
    nobody = STATION.model_copy(update={"panda_hand": PandaHandSettings(address="127.0.0.9")})
    with pytest.raises(DriverUnavailable, match=r"panda_hand\.address"):
        PandaHand(nobody).connect()
