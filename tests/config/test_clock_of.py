"""Only a cell of which nothing is real, and nothing elsewhere, lets time wait for its machine."""

from __future__ import annotations

from pathlib import Path

import pytest

from bus.clock import WALL_CLOCK
from config.clock import clock_of
from config.load import load_station

CONFIG = Path(__file__).parents[2] / "config"


@pytest.mark.parametrize("file", ["sim", "bin", "openai", "gemini"])
@pytest.mark.parametrize("pace", [0, 1])
def test_a_simulated_cell_waits_for_its_machine_at_any_pace(file: str, pace: int) -> None:
    clock = clock_of(load_station(CONFIG / f"{file}.toml", [f"sim.pace={pace}"]))
    assert clock.is_slowed


@pytest.mark.parametrize("file", ["lab", "stand_in"])
def test_real_drivers_are_watched_by_the_wall_clock(file: str) -> None:
    assert clock_of(load_station(CONFIG / f"{file}.toml")) is WALL_CLOCK


REAL_ARM = (
    'nodes={eye = {driver = "sim", serves = ["camera"]}, arm = {driver = "fr3", serves = ["arm"]},'
    ' hand = {driver = "sim", serves = ["hand"]}}'
)


@pytest.mark.parametrize(
    "overrides",
    [
        [REAL_ARM],
        [REAL_ARM, "sim.pace=0"],
        ["bus.router=tls/192.168.1.5:7447", "bus.zenoh=cell.json5"],
        ["bus.listen=tls/192.168.1.10:7448", "bus.zenoh=cell.json5"],
        ["bus.endpoint=tls/192.168.1.10:7448", "bus.zenoh=cell.json5"],
    ],
)
def test_so_is_a_simulated_camera_beside_a_real_arm_and_whatever_goes_through_a_network(overrides: list[str]) -> None:
    station = load_station(None, overrides)
    assert clock_of(station) is WALL_CLOCK


def test_a_real_arm_beside_a_simulated_camera_brakes_as_soon_as_any() -> None:
    assert load_station(None, [REAL_ARM, "sim.pace=0"]).silence_s == load_station(CONFIG / "lab.toml").silence_s == 0.5


def test_a_process_has_one_measured_time() -> None:
    stations = load_station(None, ["sim.seed=1"]), load_station(None, ["sim.pace=1"])
    assert clock_of(stations[0]) is clock_of(stations[1])
