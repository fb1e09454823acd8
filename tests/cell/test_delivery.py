"""What was held and is not in the hand any more when it is to be laid down, was dropped."""

from __future__ import annotations

import pytest

from bus.messages import HandState
from cell.pick.verify import lost_on_the_way, opened_by_another
from config.load import load_station

STATION = load_station()


def _hand(width_mm: float) -> HandState:
    return HandState(stamp_ns=1, width_m=width_mm / 1e3, is_moving=False, is_homed=True)


@pytest.mark.parametrize("width_mm", [19.0, 20.0, 21.0])
def test_fingers_that_still_press_hold(width_mm: float) -> None:
    assert lost_on_the_way(_hand(20.0), _hand(width_mm), STATION) == ""


def test_fingers_that_met_have_lost_it() -> None:
    assert "closed" in lost_on_the_way(_hand(20.0), _hand(0.1), STATION)


@pytest.mark.parametrize("width_mm", [30.0, 72.0, 80.0])
def test_a_hand_that_somebody_else_opened_has_lost_it(width_mm: float) -> None:
    assert "somebody else moved it" in lost_on_the_way(_hand(20.0), _hand(width_mm), STATION)
    assert opened_by_another(_hand(20.0), width_mm / 1e3, STATION)
