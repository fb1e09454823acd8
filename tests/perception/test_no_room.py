"""Why there is no grasp: the reason names what is in the way, never contradicts the widths, and the advice fits it."""

from __future__ import annotations

import re

import pytest

from bus.codes import ADVICE, Code
from bus.errors import CycleFailure
from bus.messages import Observation
from config.load import load_station
from perception.detector import detect
from perception.models import open_models
from tests.perception.from_aside import LEFT, Solid, look

STATION = load_station()


def _no_grasp(seen: Observation) -> CycleFailure:
    with pytest.raises(CycleFailure) as failure:
        detect(seen, STATION, open_models(STATION, {}), lambda _: None)
    assert failure.value.failure is Code.NO_GRASP
    assert failure.value.advice != ADVICE[Code.NO_GRASP], "it fits what is in the way"
    return failure.value


def _slab(y_m: float = 0.0, width_m: float = 0.05) -> Solid:
    return Solid((0.46, y_m, 0.0), (0.2, width_m, 0.1))


def test_what_is_wider_than_the_jaw_is_too_wide() -> None:
    failure = _no_grasp(look([_slab(width_m=0.12)]))
    assert "118 mm wide: wider than the jaw" in failure.text and "narrow part" in failure.advice


def test_what_is_narrow_enough_has_something_beside_it() -> None:
    failure = _no_grasp(look([_slab(), _slab(0.055), _slab(-0.055)]))
    assert "On the one of 49 mm: something beside it is in the way of the fingers" in failure.text
    assert failure.advice.startswith("Make room")


def test_depth_that_scatters_is_named_before_the_widths_that_it_spoils() -> None:
    failure = _no_grasp(look([_slab()], noise_m=0.02))
    assert "ragged, since depth scatters by 10 mm" in failure.text and "depth image" in failure.advice


def test_what_was_not_seen_beside_it_is_measured() -> None:
    """From aside the far half of the space around it is hidden, and its far face, too."""
    failure = _no_grasp(look([Solid((0.46, 0.0, 0.0), (0.1, 0.078, 0.06))], LEFT))
    assert re.search(r"79 mm wide: of the space beside it \d+ cm2 \(\d+%\) were not seen", failure.text)
    assert "another side" in failure.advice
