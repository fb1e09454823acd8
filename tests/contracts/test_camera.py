"""What every RGB-D camera does."""

from __future__ import annotations

from tests.contracts.conftest import EveryImplementation
from vlad_cell.testing import CameraSuite


class TestCamera(EveryImplementation, CameraSuite):
    """The suite that other packages run on theirs."""
