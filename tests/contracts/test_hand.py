"""What every hand does."""

from __future__ import annotations

from tests.contracts.conftest import EveryImplementation
from vlad_cell.testing import HandSuite


class TestHand(EveryImplementation, HandSuite):
    """The suite that other packages run on theirs."""
