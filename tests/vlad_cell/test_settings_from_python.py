"""Settings as a program gives them: numbers, arrays, and tables as dicts."""

from __future__ import annotations

import numpy as np
import pytest

from bus.errors import ConfigError
from config.load import load_station
from vlad_cell.station import station_of

LEFT = {"name": "left", "position_m": np.array([0.4, 0.4, 0.2]), "yaw_rad": None}
RIGHT = {"name": "right", "position_m": (0.4, 0.5, 0.2), "capacity": 3}


def test_tables_are_dicts_and_several_are_a_list_of_them() -> None:
    places = station_of(settings={"scene.places": [LEFT, RIGHT]}).scene.places
    assert [(one.name, one.position_m, one.capacity) for one in places] == [
        ("left", (0.4, 0.4, 0.2), 0),
        ("right", (0.4, 0.5, 0.2), 3),
    ]
    again = station_of(load_station(), {"scene.places": places})
    assert again.scene.places == places, "settings of another station, too"


def test_a_plug_ins_table_has_any_keys() -> None:
    given = {"serial no.": 'a "b"', "speed": 2.5, "deep": {"x": [1, 2]}}
    station = station_of(settings={"perception.settings": given})
    assert station.perception.settings == given


def test_what_is_no_station_and_no_settings_is_refused_with_what_to_pass() -> None:
    with pytest.raises(ConfigError, match=r'settings is of list.*settings=\{"hand'):
        station_of(settings=["hand.max_width_m=0.05"])  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match=r"config is of dict.*Single settings go into settings"):
        station_of({"hand": {"max_width_m": 0.05}})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ([{"name": "left"}], r"scene\.places\.0\.position_m is missing, with settings\['scene\.places'\]"),
        ([{**LEFT, "postion_m": 1}], r"Unknown key .*Did you mean"),
        ([{**LEFT, "position_m": {0.4}}], r"scene\.places is of list\. Correct settings\['scene\.places'\]"),
    ],
)
def test_what_is_wrong_in_a_table_is_named(value: object, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        station_of(settings={"scene.places": value})
