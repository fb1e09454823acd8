"""What every hand does."""

from __future__ import annotations

import time
from typing import cast

import pytest

from drivers.interface import Hand
from tests.contracts.conftest import EveryImplementation
from vlad_cell.testing import HandSuite


class TestHand(EveryImplementation, HandSuite):
    """The suite that other packages run on theirs."""


def test_a_hand_whose_state_waits_for_its_device_does_not_pass() -> None:
    class Slow:
        def state(self) -> None:
            time.sleep(0.06)

    with pytest.raises(AssertionError):
        HandSuite().test_its_state_does_not_wait(cast(Hand, Slow()))
