"""A value of another kind than the setting's is a mistake, and so is one that only another unit explains."""

from __future__ import annotations

import json

import pytest

from bus.errors import ConfigError
from config.load import load_station, station_from


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("hand.max_width_m=true", "valid number"),
        ("hand.grasp_force_n='30'", "valid number"),
        ("http.port='8088'", "valid integer"),
        ("sim.seed=3.5", "valid integer"),
        ("http.enabled=yes", "valid boolean"),
        ("http.enabled=1", "valid boolean"),
        ("capture.views=true", "a number, or a word in quotes"),
        ("scene.place_m=[0.4, true, 0.2]", "valid number"),
        ("scene.obstacles=[{name='lid', center_m=['0', 0, 0], size_m=[1, 1, 1]}]", "valid number"),
        ("hand.max_width_m=8", "less than or equal to 0.5"),
        ("scene.table.tolerance_mm=0.015", "greater than or equal to 0.1"),
    ],
)
def test_a_value_of_another_kind_or_unit_is_refused(given: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        load_station(None, [given])


def test_a_whole_number_stands_for_one_with_decimals_and_a_text_needs_no_quotes() -> None:
    station = load_station(None, ["sim.pace=1", "cell_id=5", "scene.place_m=[0, 0, 1]", "recording.folder=7"])
    assert (station.sim.pace, station.cell_id, str(station.recording.folder)) == (1.0, "5", "7")


def test_a_station_comes_back_from_the_json_of_its_recording() -> None:
    station = load_station(None, ["capture.views=2"])
    assert station_from(json.loads(station.model_dump_json())) == station
