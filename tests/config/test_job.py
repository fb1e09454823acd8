"""What a job changes in the station's settings, and which jobs a station refuses, naming the field."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from bus.errors import Refused
from bus.messages import GraspHints, Job, Place, Target
from config.job import capacity_of, require_possible, set_by, station_for
from config.load import load_station
from config.words import understood

PLACES = 'scene.places=[{name="left", position_m=[0.4, 0.45, 0.15], pattern_m=[[0, 0], [0.1, 0]], capacity=2}]'
CUP = 'perception.labels=[{name="cup", color="blue", height_m=[0.06, 0.12]}]'


def test_an_empty_job_changes_nothing() -> None:
    assert station_for(load_station(), Job(), 0) == load_station()


def test_a_cycle_runs_with_the_targets_and_place_of_its_job() -> None:
    job = Job(target=Target(text="red"), place=Place(position_m=(0.4, 0.45, 0.2), yaw_rad=1.0),
              grasp=GraspHints(max_force_n=10, from_above=True))  # fmt: skip
    station = station_for(load_station(), job, 3)
    assert station.perception.target.text == "red"
    assert station.perception.from_above
    assert (station.scene.place_m, station.scene.place_yaw_rad) == ((0.4, 0.45, 0.2), 1.0)
    assert station.hand.grasp_force_n == 10


def test_a_job_never_presses_harder_than_the_station() -> None:
    station = station_for(load_station(), Job(grasp=GraspHints(max_force_n=60)), 0)
    assert station.hand.grasp_force_n == load_station().hand.grasp_force_n


def test_at_the_place_of_a_job_nothing_is_laid_on_top_of_others() -> None:
    station = load_station(None, ["scene.place_higher_m=0.1", PLACES])
    for job, higher_m in ((Job(), 0.1), (Job(place=Place(name="left")), 0.0)):
        assert station_for(station, job, 0).scene.place_higher_m == higher_m
        assert set_by(job, "scene.place_higher_m") is (higher_m == 0.0)


def test_a_named_place_follows_its_own_pattern() -> None:
    station = load_station(None, [PLACES])
    job = Job(place=Place(name="left"))
    places = [station_for(station, job, laid).scene.place_m for laid in range(3)]
    assert places == [(0.4, 0.45, 0.15), (0.5, 0.45, 0.15), (0.4, 0.45, 0.15)]
    assert capacity_of(station, "left") == 2
    assert capacity_of(station, "") == 0, "the station's own tray"


@pytest.mark.parametrize(
    ("job", "field", "why"),
    [
        (Job(target=Target(text="zebra")), "target.text", "does not understand: 'zebra'"),
        (Job(target=Target(box=(5, 5, 1, 9))), "target.box", "upper left"),
        (Job(target=Target(point_m=(0, 0, 0))), "target.point_m", "outside the pick region"),
        (Job(place=Place(name="nowhere")), "place.name", "there are left"),
        (Job(place=Place(position_m=(5, 5, 0.1))), "place.position_m", "no table, tray or box"),
        (Job(place=Place(position_m=(0.4, 0.45, 0.0))), "place.position_m", "below what is there"),
        (Job(place=Place(position_m=(0.4, 0.45, 0.6))), "place.position_m", "0.58 m above what is there"),
        (Job(grasp=GraspHints(max_force_n=100)), "grasp.max_force_n", "at most 70 N"),
    ],
)
def test_a_refusal_names_the_field_and_says_why(job: Job, field: str, why: str) -> None:
    with pytest.raises(Refused, match=field) as refused:
        require_possible(load_station(None, [PLACES]), job, reads_text=False)
    assert refused.value.code == "BAD_JOB"
    assert why in str(refused.value)


@pytest.mark.parametrize("target", [
    {"pixel": (1280, 90)}, {"pixel": (90, 720)}, {"box": (1280, 0, 1300, 90)}, {"box": (0, 720, 9, 800)},
])  # fmt: skip
def test_what_is_outside_the_picture_is_refused_as_soon_as_its_size_is_known(target: dict[str, Any]) -> None:
    (way,) = target
    with pytest.raises(Refused, match=rf"target.{way}: .*outside the picture, which has 1280 x 720 pixels") as refused:
        require_possible(load_station(), Job(target=Target(**target)), reads_text=False, picture_px=(1280, 720))
    assert refused.value.code == "BAD_JOB"


def test_what_is_in_the_picture_or_partly_in_it_is_not_refused() -> None:
    for target in (Target(pixel=(1279, 719)), Target(pixel=(0, 0)), Target(box=(1200, 600, 5000, 5000))):
        require_possible(load_station(), Job(target=target), reads_text=False, picture_px=(1280, 720))
    require_possible(load_station(), Job(target=Target(pixel=(5000, 0))), reads_text=False)  # no picture was taken yet


def test_a_model_that_reads_takes_any_words() -> None:
    require_possible(load_station(), Job(target=Target(text="zebra")), reads_text=True)


@pytest.mark.parametrize(
    "fields",
    [
        {"target": {}},
        {"target": {"text": "red", "pixel": [1, 2]}},
        {"target": {"pixel": [1]}},
        {"target": {"point_m": [0.4, 0, float("nan")]}},
        {"place": {}},
        {"place": {"name": "left", "position_m": [0.4, 0.4, 0.2]}},
        {"place": {"name": "left", "yaw_rad": 1.0}},
        {"deadline_s": 0},
        {"grasp": {"max_force_n": -1}},
        {"job_id": "two\nlines"},
        {"unknown": 1},
    ],
)
def test_a_job_that_is_none_is_not_made(fields: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        Job.model_validate(fields)


# --- words ------------------------------------------------------------------------------------------------------------


def test_words_ask_for_a_colour_a_superlative_and_a_label_of_the_station() -> None:
    labels = load_station(None, [CUP]).perception.labels
    wanted = understood("the Largest gray one", labels)
    assert (wanted.color, wanted.superlative, wanted.label) == ("grey", "largest", None)
    wanted = understood("leftmost cup, please", labels)
    assert (wanted.superlative, wanted.label) == ("leftmost", labels[0])


@pytest.mark.parametrize("text", ["", "the one", "zebra", "red blue", "largest smallest", "not red"])
def test_words_that_say_nothing_or_two_things_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"understand|two things"):
        understood(text, ())
