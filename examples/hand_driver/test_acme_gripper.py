"""The gripper does what every hand does: ``pytest`` in this folder, with the package installed."""

from typing import Any, ClassVar

from vlad_cell.testing import HandSuite


class TestGripper(HandSuite):
    """With the settings that the station file would have."""

    name = "acme_gripper"
    settings: ClassVar[dict[str, Any]] = {"port": "/dev/null", "poll_s": 0.005}
