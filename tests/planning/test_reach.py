"""Whether the arm reaches a place at all: every station's own places, and not the corner of the table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from config.load import load_station
from planning.reach import reaches
from planning.robot import Robot

STATIONS = sorted(path for path in (Path(__file__).parents[2] / "config").glob("*.toml"))


@pytest.mark.parametrize("station", [None, *STATIONS], ids=lambda path: "default" if path is None else path.stem)
def test_every_station_of_ours_reaches_its_own_places(robot: Robot, station: Path | None) -> None:
    scene = load_station(station).scene
    for place_m in (scene.place_m, *(one.position_m for one in scene.places)):
        assert reaches(robot.arm, np.array(place_m))


@pytest.mark.parametrize("place_m", [(0.85, 0.65, 0.10), (0.40, 0.45, 1.20)])
def test_what_no_direction_of_the_hand_reaches_is_out_of_reach(robot: Robot, place_m: tuple[float, ...]) -> None:
    assert not reaches(robot.arm, np.array(place_m))


def test_what_only_a_leaning_hand_reaches_is_in_reach(robot: Robot) -> None:
    assert reaches(robot.arm, np.array((0.70, 0.50, 0.25)))
