"""Checks that a driver, a detector or a goal-image model of another package passes: one suite a kind, for pytest.

::

    from vlad_cell.testing import HandSuite

    class TestGripper(HandSuite):
        name = "acme_gripper"

Without writing anything: ``python -m vlad_cell.testing driver acme_gripper``. Needs pytest.
"""

import pytest

pytest.register_assert_rewrite(
    *(f"{__name__}.{module}" for module in ("arm", "camera", "detector", "devices", "goal_model", "hand", "plug_in"))
)

from vlad_cell.testing.arm import ArmSuite  # noqa: E402 - pytest rewrites the asserts of what is imported from here on
from vlad_cell.testing.camera import CameraSuite  # noqa: E402
from vlad_cell.testing.detector import DetectorSuite  # noqa: E402
from vlad_cell.testing.goal_model import GoalModelSuite  # noqa: E402
from vlad_cell.testing.hand import HandSuite  # noqa: E402

__all__ = ["ArmSuite", "CameraSuite", "DetectorSuite", "GoalModelSuite", "HandSuite"]
