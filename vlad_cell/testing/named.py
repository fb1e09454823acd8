"""The suites as tests, for ``python -m vlad_cell.testing``, which names the plug-in."""

from __future__ import annotations

import pytest

from drivers.interface import Devices
from vlad_cell.testing import ArmSuite, CameraSuite, DetectorSuite, GoalModelSuite, HandSuite


class _ServesSome:
    """A driver that brings no such device is not tried for it."""

    device = ""

    @pytest.fixture(autouse=True)
    def _brings(self, devices: Devices) -> None:
        if getattr(devices, self.device) is None:
            pytest.skip(f"the driver brings no {self.device}")


class TestCamera(_ServesSome, CameraSuite):
    """A driver's camera."""

    device = "camera"


class TestArm(_ServesSome, ArmSuite):
    """A driver's arm."""

    device = "arm"


class TestHand(_ServesSome, HandSuite):
    """A driver's hand."""

    device = "hand"


class TestDetector(DetectorSuite):
    """A detector."""


class TestGoalModel(GoalModelSuite):
    """A goal-image model."""


SUITES = {
    "driver": (TestCamera, TestArm, TestHand),
    "detector": (TestDetector,),
    "goal-model": (TestGoalModel,),
}
"""By the kind of plug-in."""
