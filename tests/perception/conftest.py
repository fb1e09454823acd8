"""Small made-up scenes: boxes on a table, seen from straight above."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest

from bus.messages import Observation
from vlad_cell.testing.scene import BAR, CAMERA, PLATE, Box, seen

__all__ = ["BAR", "CAMERA", "PLATE", "Box", "Look"]
Look = Callable[[Sequence[Box]], Observation]


@pytest.fixture
def look() -> Look:
    return seen
