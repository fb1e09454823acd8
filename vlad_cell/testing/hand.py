"""The checks that every hand passes."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest

from bus.errors import HandFault, NotConnected
from config.schema import Station
from drivers.interface import Devices, Hand
from vlad_cell.testing.devices import DriverSuite


class HandSuite(DriverSuite):
    """The checks of a hand. It opens and closes fully, several times: nothing may be between the fingers."""

    @pytest.fixture
    def hand(self, devices: Devices) -> Iterator[Hand]:
        """Yield the hand, connected."""
        assert devices.hand is not None, "the driver brings no hand"
        devices.hand.connect()
        yield devices.hand

    def test_it_implements_the_protocol(self, devices: Devices) -> None:
        assert isinstance(devices.hand, Hand)

    def test_homing_ends_open_and_homed(self, hand: Hand, station: Station) -> None:
        state = hand.home()
        assert state.is_homed and not state.is_moving and state.width_m > 0.875 * station.hand.max_width_m

    @pytest.mark.parametrize("share", [0.25, 0.75, 1.0, 0.0])
    def test_it_moves_to_a_width(self, hand: Hand, station: Station, share: float) -> None:
        width_m = share * station.hand.max_width_m
        assert hand.move(width_m, 0.1).width_m == pytest.approx(width_m, abs=2e-3)

    def test_grasping_nothing_closes_fully(self, hand: Hand, station: Station) -> None:
        hand.move(station.hand.max_width_m, 0.1)
        assert hand.grasp(30.0, 0.1).width_m < 2e-3
        hand.move(station.hand.max_width_m, 0.1)

    @pytest.mark.parametrize("width_m", [-0.01, 0.2, float("nan")])
    def test_an_impossible_width_is_refused(self, hand: Hand, width_m: float) -> None:
        before = hand.state().width_m
        with pytest.raises(HandFault):
            hand.move(width_m, 0.1)
        assert hand.state().width_m == pytest.approx(before, abs=1e-3)

    def test_its_state_does_not_wait(self, hand: Hand) -> None:
        """It is asked for 20 times a second. The quickest of some answers counts: this machine may be busy."""
        took_s = []
        for _ in range(5):
            began_s = time.perf_counter()
            hand.state()
            took_s.append(time.perf_counter() - began_s)
        assert min(took_s) < 0.05

    def test_stop_never_raises(self, hand: Hand) -> None:
        hand.stop()

    def test_before_connect_and_after_close_it_says_so(self, devices: Devices) -> None:
        hand = devices.hand
        assert hand is not None
        hand.connect()
        hand.close()
        hand.close()
        with pytest.raises(NotConnected):
            hand.state()
        hand.connect()
        assert hand.state().width_m >= 0
