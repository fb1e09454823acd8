"""Station files: strict, overridable, and clear about what is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from bus.errors import ConfigError
from config.load import DEFAULT_STATION, load_station, station_from, station_hash


def test_the_default_station_is_the_simulated_cell() -> None:
    station = load_station()
    assert station.cell_id == "sim" and station.simulated


@pytest.mark.parametrize("file", sorted(DEFAULT_STATION.parent.glob("*.toml")), ids=lambda file: file.stem)
def test_every_station_file_loads(file: Path) -> None:
    assert load_station(file).cell_id


def test_the_lab_is_real_slow_and_strict() -> None:
    station = load_station(DEFAULT_STATION.with_name("lab.toml"))
    assert not station.simulated
    assert {node.driver for node in station.nodes.values()} == {"fr3", "panda_hand", "femto_mega"}
    assert station.fr3.realtime == "enforce" and station.fr3.load.mass_kg > 0 and station.arm.speed <= 0.25
    assert station.fr3.address == station.panda_hand.address and station.femto_mega.address is not None


def test_overrides_take_toml_values_and_bare_text() -> None:
    station = load_station(None, ["sim.pace=1", "sim.objects=some/folder", "perception.compliance=1.5"])
    assert (station.sim.pace, station.sim.objects, station.perception.compliance) == (1, Path("some/folder"), 1.5)


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("sim.pase=1", r"Unknown key 'sim.pase'.*Did you mean 'pace'"),
        ("nonsense.key=1", r"Unknown key 'nonsense'"),
        ("sim.pace=fast", r"sim.pace.*number.*'fast'"),
        ("perception.compliance=-1", r"perception.compliance.*greater than 0"),
        ("sim.pace", r"not of the form key=value"),
        ("cell_id.x=1", r"no keys below"),
        ("bus.endpoint=tcp/0.0.0.0:7447", r"only loopback"),
        ("nodes.sim.serves=['arm']", r"exactly once each"),
    ],
)
def test_a_wrong_override_says_what_is_wrong(override: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says) as error:
        load_station(None, [override])
    assert "\n" not in str(error.value) and error.value.exit_code == 2


def test_a_missing_file_and_broken_toml_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no station file"):
        load_station(tmp_path / "absent.toml")
    (tmp_path / "broken.toml").write_text("cell_id = ")
    with pytest.raises(ConfigError, match="not valid TOML"):
        load_station(tmp_path / "broken.toml")


def test_the_hash_tells_stations_apart_and_survives_json() -> None:
    station = load_station()
    assert station_hash(station) == station_hash(station_from(station.model_dump(mode="json")))
    assert station_hash(station) != station_hash(load_station(None, ["sim.seed=1"]))
