"""What every hand does."""

from __future__ import annotations

import pytest

from bus.errors import HandFault, NotConnected
from drivers.interface import Devices, Hand


def test_it_implements_the_protocol(devices: Devices) -> None:
    assert isinstance(devices.hand, Hand)


def test_homing_ends_open_and_homed(hand: Hand) -> None:
    state = hand.home()
    assert state.is_homed and not state.is_moving and state.width_m > 0.07


@pytest.mark.parametrize("width_m", [0.02, 0.06, 0.08, 0.0])
def test_it_moves_to_a_width(hand: Hand, width_m: float) -> None:
    assert hand.move(width_m, 0.1).width_m == pytest.approx(width_m, abs=2e-3)


def test_grasping_nothing_closes_fully(hand: Hand) -> None:
    hand.move(0.08, 0.1)
    assert hand.grasp(30.0, 0.1).width_m < 2e-3
    hand.move(0.08, 0.1)


@pytest.mark.parametrize("width_m", [-0.01, 0.2, float("nan")])
def test_an_impossible_width_is_refused(hand: Hand, width_m: float) -> None:
    before = hand.state().width_m
    with pytest.raises(HandFault):
        hand.move(width_m, 0.1)
    assert hand.state().width_m == pytest.approx(before, abs=1e-3)


def test_stop_never_raises(hand: Hand) -> None:
    hand.stop()


def test_before_connect_and_after_close_it_says_so(devices: Devices) -> None:
    hand = devices.hand
    assert hand is not None
    hand.connect()
    hand.close()
    hand.close()
    with pytest.raises(NotConnected):
        hand.state()
    hand.connect()
    assert hand.state().width_m >= 0
