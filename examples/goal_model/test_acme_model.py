"""The model does what every goal-image model does: ``pytest`` in this folder, with the package installed."""

from typing import Any, ClassVar

from vlad_cell.testing import GoalModelSuite


class TestCrosswise(GoalModelSuite):
    """With the settings that the station file would have."""

    name = "acme"
    settings: ClassVar[dict[str, Any]] = {"height": 0.6}
