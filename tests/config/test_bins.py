"""Bins of the scene: where their walls stand, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bus.errors import ConfigError
from bus.messages import Job
from config.job import station_for
from config.load import DEFAULT_STATION, load_station
from config.scene import Bin, scene_boxes

BIN_STATION = DEFAULT_STATION.with_name("bin.toml")
BIN = "scene.bins=[{name='bin', center_m=[0.46, 0.0], size_m=[0.38, 0.52]}]"


def test_the_walls_stand_on_the_table_around_the_inside() -> None:
    walls = {wall.name: wall for wall in Bin(name="box", center_m=(0.5, 0.1), size_m=(0.2, 0.4)).walls}
    assert walls.keys() == {"box-front", "box-back", "box-right", "box-left"}
    front, left = walls["box-front"], walls["box-left"]
    assert front.center_m[0] + front.size_m[0] / 2 == pytest.approx(0.5 - 0.2 / 2)
    assert left.center_m[1] - left.size_m[1] / 2 == pytest.approx(0.1 + 0.4 / 2)
    assert front.size_m[1] == pytest.approx(0.4 + 2 * 0.01), "the corners are closed"
    for wall in walls.values():
        assert wall.center_m[2] - wall.size_m[2] / 2 == pytest.approx(0.0)
        assert wall.size_m[2] == pytest.approx(0.08)


def test_the_scene_of_the_bin_station_holds_its_walls() -> None:
    scene = load_station(BIN_STATION).scene
    names = [box.name for box in scene_boxes(scene)]
    assert {f"bin-{side}" for side in ("front", "back", "right", "left")} <= set(names)
    assert len(names) == len(set(names))


def test_without_bins_the_scene_is_as_before() -> None:
    names = [box.name for box in scene_boxes(load_station().scene)]
    assert names == ["table", "tray", "tray-front", "tray-back", "tray-right", "tray-left"]


@pytest.mark.parametrize(
    ("region", "wall"),
    [("[0.26, 0.60, -0.2, 0.2]", "bin-front"), ("[0.3, 0.6, -0.2, 0.265]", "bin-left"), ("[0, 1, -1, 1]", "bin")],
)
def test_a_pick_region_that_reaches_into_a_wall_is_refused_with_its_name(region: str, wall: str) -> None:
    with pytest.raises(ConfigError, match=f"reaches into the wall '{wall}"):
        load_station(None, [BIN, f"scene.pick_region_m={region}"])


def test_a_pick_region_may_touch_the_walls_or_lie_elsewhere() -> None:
    load_station(None, [BIN, "scene.pick_region_m=[0.27, 0.65, -0.26, 0.26]"])
    load_station(None, [BIN, "scene.pick_region_m=[0.3, 0.6, -0.5, -0.3]"])


@pytest.mark.parametrize("name", ["tray", "table"])
def test_a_name_used_twice_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=f"used twice: {name}"):
        load_station(None, [BIN.replace("'bin'", f"'{name}'")])


def test_an_obstacle_cannot_take_a_walls_name(tmp_path: Path) -> None:
    station = tmp_path / "station.toml"
    obstacle = "[[scene.obstacles]]\nname = 'bin-left'\ncenter_m = [0, 1, 0]\nsize_m = [0.1, 0.1, 0.1]\n"
    station.write_text(f"{BIN_STATION.read_text()}\n{obstacle}")
    with pytest.raises(ConfigError, match="used twice: bin-left"):
        load_station(station)


def test_the_place_follows_its_pattern_and_begins_again() -> None:
    station = load_station(None, ["scene.place_pattern_m=[[0, 0], [0.1, -0.05]]"])
    x, y, z = station.scene.place_m
    places = [station_for(station, Job(), number).scene.place_m for number in range(3)]
    assert places == [(x, y, z), pytest.approx((x + 0.1, y - 0.05, z)), (x, y, z)]
    assert np.allclose(station_for(station, Job(), 1).scene.place_pattern_m, [(0, 0), (-0.1, 0.05)]), "then the others"
    again = station_for(station, Job(), 1)
    assert station_for(again, Job(), 0) == again, "a recording's station is at its place"


def test_without_a_pattern_the_station_stays_what_it_is() -> None:
    assert station_for(load_station(), Job(), 7) == load_station()
