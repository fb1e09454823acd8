"""Among several things: a second, closer search where the first finds nothing, and what is held for certain first."""

from __future__ import annotations

import numpy as np
import pytest

import perception.detector as detector
from bus.errors import CycleFailure
from bus.messages import Grasp, Observation
from cell.pick.detect import detect
from cell.pick.verify import _cleared
from config.load import load_station
from perception.grasps.rank import among_others
from perception.grasps.search import CLOSE, USUAL, Density, search
from perception.models import open_models
from perception.scene.change import cleared_fraction
from perception.scene.look import Look
from perception.scene.scene import scene_of
from tests.perception.from_aside import ABOVE, LEFT, RIGHT, Solid, look

STATION = load_station()
BAR = Solid((0.46, 0.0, 0.0), (0.15, 0.03, 0.05))
_ALONG_THE_BAR_ONLY = Density(headings=1, level_m=0.008, most=900)


def _grasps(*looks: Observation) -> tuple[Grasp, ...]:
    return detect(looks, STATION, open_models(STATION, {}), detector.ignore_reply).grasps


def _held(score: float, **terms: float) -> Grasp:
    sound = {"central": 1.0, "robust": 1.0, "patch": 1.0, "square": 1.0}
    return Grasp(base_from_tcp=np.eye(4), width_m=0.04, opening_m=0.06, score=score, rectangle=0,
                 imagined_base_from_tcp=np.eye(4), terms={**sound, **terms})  # fmt: skip


def test_where_the_usual_search_finds_nothing_a_closer_one_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(detector, "USUAL", _ALONG_THE_BAR_ONLY)
    across = _grasps(look([BAR], ABOVE))[0]
    assert across.width_m == pytest.approx(0.03, abs=0.005)
    monkeypatch.setattr(detector, "CLOSE", _ALONG_THE_BAR_ONLY)
    with pytest.raises(CycleFailure, match="ways to grasp would be free"):
        _grasps(look([BAR], ABOVE))


def test_the_closer_search_finds_more_places() -> None:
    heights = scene_of([Look.of(look([BAR], ABOVE), STATION)], STATION).heights
    usual, close = (search(heights, STATION, density=density) for density in (USUAL, CLOSE))
    assert np.isfinite(close.score).sum() > 2 * np.isfinite(usual.score).sum() > 0


def test_when_nothing_is_found_from_above_every_thing_is_looked_at_from_its_sides(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    looked_at: list[int] = []

    def no_sides(_scene: object, _instances: object, number: int, _station: object) -> tuple[()]:
        looked_at.append(number)
        return ()

    monkeypatch.setattr(detector, "search_sides", no_sides)
    too_wide = [Solid((x, y, 0.0), (0.12, 0.12, 0.05)) for x in (0.36, 0.56) for y in (-0.16, 0.0, 0.16)]
    with pytest.raises(CycleFailure):
        _grasps(*(look(too_wide, direction) for direction in (ABOVE, LEFT, RIGHT)))
    assert sorted(looked_at) == [1, 2, 3, 4, 5, 6]


def test_what_lacks_something_needed_comes_after_what_is_sound() -> None:
    held_at_its_end, sound = _held(0.85, central=0.1), _held(0.80, central=0.5)
    first, second = among_others((held_at_its_end, sound), STATION)
    assert first.score == 0.80 and first.terms == sound.terms
    assert second.score == pytest.approx(0.85 * (1 - 0.25 * 0.75)) and second.terms == held_at_its_end.terms


def test_what_has_all_that_is_needed_keeps_its_score_and_order() -> None:
    grasps = (_held(0.9, central=0.4), _held(0.7, robust=0.5), _held(0.6, patch=0.43))
    assert among_others(grasps, STATION) == grasps


def test_of_what_may_be_several_things_the_part_that_the_pads_held_must_have_left() -> None:
    """Two boxes of one colour that touch are one thing; the higher one is taken."""
    low, high = Solid((0.46, 0.06, 0.0), (0.12, 0.07, 0.02)), Solid((0.46, 0.0, 0.0), (0.12, 0.05, 0.07))
    before, without = look([low, high]), look([low])
    found = detect([before], STATION, open_models(STATION, {}))
    grasp = found.grasps[0]
    assert len(found.scene.instances) == 1 and abs(grasp.base_from_tcp[1, 3]) < 0.01 and grasp.width_m < 0.06
    whole = cleared_fraction(found, grasp.instance, before, without, STATION)
    assert whole is not None and whole < STATION.verify.min_cleared_fraction
    assert _cleared(found, grasp, before, without, STATION) == pytest.approx(1.0, abs=0.05)
    assert _cleared(found, grasp, before, before, STATION) == pytest.approx(0.0, abs=0.05)
