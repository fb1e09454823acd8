"""A target by words, box or point; what is said when it is not there, and when something lies on it."""

from __future__ import annotations

import pytest

from bus.codes import Code
from bus.errors import CycleFailure
from bus.messages import Detections, Observation
from config.load import load_station
from perception.detector import detect, ignore_reply
from perception.models import open_models
from tests.perception.conftest import BAR, PLATE, Box, Look

RED_BAR = Box((300, 400), (180, 204), 0.04, (200, 40, 40))
GREEN_BAR = Box((300, 400), (260, 284), 0.02, (40, 170, 60))
CUP = 'perception.labels=[{name="cup", color="green", height_m=[0.01, 0.03]}]'
"""`BAR` is blue, in the upper left of the picture."""


def _detect(observation: Observation, *overrides: str) -> Detections:
    station = load_station(None, ["scene.pick_region_m=[0.1, 0.8, -0.3, 0.3]", *overrides])
    return detect(observation, station, open_models(station, {}), ignore_reply)


@pytest.mark.parametrize(
    ("text", "pixel"),
    [
        ("the red one", (190, 350)),
        ("blue", (112, 130)),
        ("green", (270, 350)),
        ("tallest", (190, 350)),
        ("flattest", (270, 350)),
        ("leftmost", (112, 130)),
        ("the rightmost green thing", (270, 350)),
        ("cup", (270, 350)),
    ],
)
def test_words_find_their_object_without_a_model(look: Look, text: str, pixel: tuple[int, int]) -> None:
    found = _detect(look([BAR, RED_BAR, GREEN_BAR]), f"perception.target.text={text}", CUP)
    assert found.evidence.object_mask[pixel]


def test_a_box_and_a_point_find_their_object(look: Look) -> None:
    scene = look([BAR, RED_BAR, GREEN_BAR])
    assert _detect(scene, "perception.target.box=[290, 170, 410, 215]").evidence.object_mask[190, 350]
    red_m = "[0.597, -0.016, 0.04]"  # 110 px and 12 px from the middle, 0.56 m away
    assert _detect(scene, f"perception.target.point_m={red_m}").evidence.object_mask[190, 350]


@pytest.mark.parametrize("target", ["text=purple", "text=the cup", "box=[0, 300, 60, 350]", "point_m=[0.3, -0.2, 0.0]"])
def test_what_is_not_there_is_never_another_object_and_what_was_seen_is_said(look: Look, target: str) -> None:
    with pytest.raises(CycleFailure, match=r"Seen: .*blue .* mm at") as failure:
        _detect(look([BAR, RED_BAR]), f"perception.target.{target}", CUP)
    assert failure.value.failure is Code.TARGET_NOT_FOUND


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ("pixel=[480, 100]", r"The pixel \(480, 100\) is outside the picture, which has 480 x 360 pixels\. Seen:"),
        ("pixel=[100, -1]", "outside the picture"),
        ("box=[100, 360, 200, 500]", r"The box \(100.0, 360.0, 200.0, 500.0\) is outside the picture, .* 480 x 360"),
        (
            "point_m=[0.79, 0.29, 0.0]",
            r"no object within 15 mm of \(0.790, 0.290\)\. That point is outside the picture",
        ),
    ],
)
def test_what_is_outside_the_picture_is_said_to_be(look: Look, target: str, said: str) -> None:
    with pytest.raises(CycleFailure, match=said) as failure:
        _detect(look([BAR]), f"perception.target.{target}")
    assert failure.value.failure is Code.TARGET_NOT_FOUND


def test_a_target_under_another_object_is_obstructed_and_the_other_one_is_named(look: Look) -> None:
    on_it = Box((300, 330), (240, 270), 0.05, (40, 170, 60))
    with pytest.raises(CycleFailure, match=r"red.*lies something: green") as failure:
        _detect(look([PLATE, on_it]), "perception.target.text=red")
    assert failure.value.failure is Code.OBSTRUCTED
    assert failure.value.obstacle_m == pytest.approx([0.55, -0.09, 0.05], abs=0.03)


def test_what_stands_beside_the_target_does_not_obstruct_it(look: Look) -> None:
    beside = Box((300, 340), (140, 172), 0.08, (40, 170, 60))
    assert _detect(look([RED_BAR, beside]), "perception.target.text=red").evidence.object_mask[190, 350]
