"""The detector does what every detector does: ``pytest`` in this folder, with the package installed."""

from typing import Any, ClassVar

from vlad_cell.testing import DetectorSuite


class TestTongs(DetectorSuite):
    """With the settings that the station file would have."""

    name = "acme"
    settings: ClassVar[dict[str, Any]] = {"headings": 36}
