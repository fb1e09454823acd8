"""Station files: strict, overridable, and clear about what is wrong."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from bus.errors import ConfigError
from config.limits import outside
from config.load import DEFAULT_STATION, load_station, station_from, station_hash
from config.scene import scene_boxes
from config.schema import Station


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


def test_a_setting_of_numbers_and_a_word_takes_both() -> None:
    given = ("capture.views=2", "capture.views=auto", "capture.views='auto'")
    assert [load_station(None, [one]).capture.views for one in given] == [2, "auto", "auto"]


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("sim.pase=1", r"Unknown key 'sim.pase' in --set sim.pase. Did you mean 'sim.pace'"),
        ("hnd.max_width_m=1", r"Unknown key 'hnd.max_width_m' in --set .*Did you mean 'hand.max_width_m'"),
        ("max_width_m=1", r"Unknown key 'max_width_m' in --set .*Did you mean 'hand.max_width_m'"),
        (
            "http.address=::",
            r"Unknown key 'http.address' in --set http.address. Known here: certificate, .*host, .*elsewhere: fr3\.",
        ),
        ("nodes.sim.drivr=x", r"Unknown key 'nodes.sim.drivr' in --set .*Did you mean 'nodes.sim.driver'"),
        ("nodes.cam.driver=sim", r"nodes.cam.serves is missing, with --set nodes.cam.driver"),
        ("nonsense.key=1", r"Unknown key 'nonsense.key' in --set .*Known here: arm, bus,"),
        ("sim.pace=fast", r"sim.pace.*number.*'fast'"),
        ("perception.align=icp", r"perception.align.*'silhouette_3d' or 'pca_cfopt'.*'icp'"),
        ("perception.compliance=-1", r"compliance: must be greater than 0 .*Correct --set perception.compliance"),
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


def test_a_mistake_is_said_to_be_where_it_was_given(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(DEFAULT_STATION.read_text() + "[hand]\nmin_width_m = -1\nwith_m = 1\n")
    both = ["hand.min_width_m=-2", "hand.with_m=1"]
    with pytest.raises(ConfigError, match=r"min_width_m: .* \(given: -1\).* Correct .*mine\.toml"):
        load_station(file, ["hand.max_width_m=0.05", "sim.pace=1"])
    with pytest.raises(ConfigError, match=r"given: -2\).* Correct --set hand\.min_width_m"):
        load_station(file, both)
    with pytest.raises(ConfigError, match=r"Unknown key 'hand.with_m' in .*mine\.toml\. Did you mean 'hand\."):
        load_station(file, ["hand.min_width_m=0.001"])
    with pytest.raises(ConfigError, match=r"exactly once each.*Correct --set nodes\.sim\.serves"):
        load_station(None, ["nodes.sim.serves=['arm']", "sim.pace=1"])
    with pytest.raises(ConfigError, match=r"Correct --seed\."):
        load_station(None, ["sim.pace=1", "sim.seed=red"], given_by={"sim.seed": "--seed"})


WRONG = {
    "camera.hand_from_color_wxyz": ["[0, 0, 0, 0]", "[1, 2, 3, 4]", "[nan, 0, 0, 1]", "[1, 0, 0]", "[0.9, 0, 0, 0]"],
    "camera.hand_from_color_position_m": ["[65, 0, 20]", "[inf, 0, 0]"],
    "scene.pick_region_m": ["[0.6, 0.3, -0.2, 0.2]", "[0.3, 0.6, 0.1, 0.1]", "[320, 600, -200, 200]"],
    "arm.capture_q_rad": ["[0, 0, 0, 0, 0, 0, 0]", "[0, -0.45, 2.8988, -1.8, 0, 1.4, 0.8]"],
    "hand.min_width_m": ["0.08"],
    "fr3.joint_stiffness_nm_rad": ["[-1, 1, 1, 1, 1, 1, 1]"],
    "planning.tilts_deg": ["[]", "[180]"],
    "verify.hold_s": ["1e9"],
    "bus.ask_timeout_s": ["1e300"],
    "calibration.squares": ["[30, 30]"],
    "calibration.dictionary": ["DICT_NONE"],
    "calibration.square_m": ["10", "0.0001"],
    "calibration.marker_m": ["0.001", "0.04"],
    "bus.endpoint": ["tcp/127.0.0.1:99999", "tcp/127.0.0.1:0", "tcp/127.0.0.1", "7447", "tls/10.0.0.300:7447"],
    "bus.listen": ["tls/[fe80::zz]:7448", "tls/a b:7448", "tls/cell.lab:70000"],
    "recording.folder": ["", "~nosuchuser/recordings", '"a\\u0000b"'],
    "perception.hosted.key_file": ["~nosuchuser/k"],
    "perception.sam.weights": ["~nosuchuser/sam"],
    "sim.objects": ["caf\udce9"],
    "sim.seed": ["1\nx = 2", "[" * 5000],
}


@pytest.mark.parametrize(("key", "value"), [(key, value) for key, values in WRONG.items() for value in values])
def test_a_value_that_cannot_be_is_refused_by_its_name(key: str, value: str) -> None:
    with pytest.raises(ConfigError) as error:
        load_station(None, [f"{key}={value}"])
    assert key.partition(".")[0] in error.value.text and len(str(error.value)) < 400


@pytest.mark.parametrize(
    ("override", "key", "text"),
    [
        ("recording.folder=2026-11-28", "folder", "2026-11-28"),
        ("recording.folder=0x10", "folder", "0x10"),
        ("recording.folder='in quotes'", "folder", "in quotes"),
        ("femto_mega.serial=12345678", "serial", "12345678"),
        ("perception.target.text=true", "text", "true"),
        ("perception.target.text=42 # red", "text", "42 # red"),
        ("nodes.sim.driver=7", "driver", "7"),
        ("perception.hosted.text_model=4.10", "text_model", "4.10"),
    ],
)
def test_a_text_is_taken_as_it_is_typed(override: str, key: str, text: str) -> None:
    table: Any = load_station(None, [override]).model_dump()
    for part in override.partition("=")[0].split(".")[:-1]:
        table = table[part]
    assert str(table[key]) == text


def test_the_home_is_found_in_every_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    paths = [f"{key}=~/x" for key in _paths(Station)]
    assert len(paths) >= 8
    station = load_station(None, paths)
    assert station.recording.folder == station.sim.objects == tmp_path / "x"
    assert "~" not in station.model_dump_json()
    file = tmp_path / "station.toml"
    file.write_text(DEFAULT_STATION.read_text() + '[perception.hosted]\nkey_file = "~/k"\n')
    assert load_station(file).perception.hosted.key_file == tmp_path / "k"
    file.write_text(DEFAULT_STATION.read_text() + '[perception.hosted]\nkey_file = "k"\n')
    assert load_station(file).perception.hosted.key_file == tmp_path / "k", "beside the station file"


def _paths(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """The keys of every setting that is a path, or may be one."""
    for name, field in model.model_fields.items():
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield from _paths(kind, f"{prefix}{name}.")
        elif "Path" in str(kind) or name == "weights":
            yield f"{prefix}{name}"


@pytest.mark.parametrize("content", ["# Prüfzelle".encode("latin-1"), "x = 1".encode("utf-16"), b"a = 1 # \x0c", b"\0"])
def test_a_file_that_is_no_utf8_toml_is_one_clear_line(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "station.toml"
    file.write_bytes(content)
    with pytest.raises(ConfigError, match=r"station\.toml is not (UTF-8 text|valid TOML)") as error:
        load_station(file)
    assert "\n" not in str(error.value)


def test_a_byte_order_mark_and_foreign_line_ends_are_read(tmp_path: Path) -> None:
    file = tmp_path / "station.toml"
    file.write_bytes(b"\xef\xbb\xbf" + DEFAULT_STATION.read_bytes().replace(b"\n", b"\r\n"))
    assert station_hash(load_station(file)) == station_hash(load_station())


def _numbers(tree: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where the numbers are in a tree."""
    entries = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in entries:
        if isinstance(value, int | float) and not isinstance(value, bool):
            yield (*path, key)
        else:
            yield from _numbers(value, (*path, key))


NUMBERS = list(_numbers(load_station(DEFAULT_STATION.with_name("bin.toml")).model_dump(mode="json")))


@given(st.sampled_from(NUMBERS), st.floats() | st.integers() | st.sampled_from([-1.0, 0.0, 1e-9, 1e6]))
def test_whatever_loads_is_finite_and_in_its_range(path: tuple[Any, ...], value: float) -> None:
    tree: Any = load_station(DEFAULT_STATION.with_name("bin.toml")).model_dump(mode="json")
    table = tree
    for part in path[:-1]:
        table = table[part]
    table[path[-1]] = value
    try:
        station = station_from(tree)
    except ConfigError as error:
        assert "\n" not in str(error)
        return
    dumped = station.model_dump(mode="json")
    assert all(math.isfinite(_at(dumped, each)) for each in _numbers(dumped))
    x_min, x_max, y_min, y_max = station.scene.pick_region_m
    assert x_min < x_max and y_min < y_max
    assert np.isclose(np.linalg.norm(station.camera.hand_from_color_wxyz), 1.0, atol=1e-3)
    assert outside(np.array(station.arm.capture_q_rad)) is None
    assert all(min(box.size_m) > 0 for box in scene_boxes(station.scene))


def _at(tree: Any, path: tuple[Any, ...]) -> Any:
    for part in path:
        tree = tree[part]
    return tree


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


def test_a_mistake_of_a_file_names_the_command_that_finds_all_of_them(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(DEFAULT_STATION.read_text() + "\n[handd]\nmax_width_m = 8\n")
    with pytest.raises(ConfigError, match=r"`cell config check .*mine.toml`"):
        load_station(file)
