"""Where a setting comes from, and every mistake of a file with its line."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

from config.json_schema import station_schema
from config.load import DEFAULT_STATION, load_station, station_from
from config.mistakes import mistakes_in
from config.new_station import Kind, cell_id_of, new_station
from config.origins import leaves, lines_of, settings
from config.schema import Station
from config.toml_text import toml_value

WRONG = """\
cell_id = "Lab One"

[bus]
stale = 3

[fr3]
realtime = "enforced"
collision_torque_nm = [
  20.0, 20.0,
  18.0,
]

[nodes.arm]
driver = "fr3"

[[scene.bins]]
name = "a"
center_m = [0.4, 0.1]
size_m = [0.3, 0.2]
[[scene.bins]]
name = "b"
size_m = [300, 0.2]

[perception.imagine]
samples = "none"
"""


def test_the_line_of_a_key_is_where_its_statement_begins() -> None:
    lines = lines_of(WRONG)
    assert lines[("fr3", "collision_torque_nm")] == 8 and lines[("nodes", "arm")] == 13
    assert lines[("scene", "bins", 0, "size_m")] == 19 and lines[("scene", "bins", 1, "size_m")] == 22


@pytest.mark.parametrize("file", sorted(DEFAULT_STATION.parent.glob("*.toml")), ids=lambda file: file.stem)
def test_every_key_of_a_file_has_its_line(file: Path) -> None:
    lines, text = lines_of(file.read_text()), file.read_text().splitlines()
    for path, line in lines.items():
        name = next(part for part in reversed(path) if isinstance(part, str))
        assert name in text[line - 1], path


def test_a_setting_comes_from_the_file_the_command_line_or_the_default() -> None:
    text, given = "[nodes.sim]\ndriver = 'sim'\nserves = ['camera', 'arm', 'hand']\nsim.pace = 1\n", ["verify.hold_s=1"]
    text = text.replace("sim.pace", "[sim]\npace")
    station = station_from(tomllib.loads(text), given)
    origins = {one.name: one.origin for one in settings(station, text, "a.toml", given)}
    assert origins["sim.pace"] == "a.toml:5" and origins["verify.hold_s"] == "--set"
    assert origins["nodes.sim.serves"] == "a.toml:3" and origins["sim.seed"] == "default"


def test_every_mistake_is_named_with_its_line_and_what_to_do(tmp_path: Path) -> None:
    file = tmp_path / "wrong.toml"
    file.write_text(WRONG)
    found = {f"{one.section}.{one.field}".lstrip("."): one for one in mistakes_in(file)}
    assert [(one.line, name) for name, one in found.items()] == [
        (1, "cell_id"),
        (4, "bus.stale"),
        (7, "fr3.realtime"),
        (8, "fr3.collision_torque_nm"),
        (13, "nodes.arm.serves"),
        (20, "scene.bins.2.center_m"),
        (22, "scene.bins.2.size_m"),
        (25, "perception.imagine.samples"),
    ]
    assert found["bus.stale"].advice == "Did you mean 'stale_s'?"
    assert found["fr3.realtime"].advice == "Did you mean 'enforce'?"
    assert "valid integer" in found["perception.imagine.samples"].text and "'auto'" in str(found)
    assert str(found["nodes.arm.serves"]) == f"{file}:13: [nodes.arm] serves: is missing. Give it in [nodes.arm]."


SIMULATED = """\
[nodes.sim]
driver = "sim"
serves = ["camera", "arm", "hand"]
"""


def checked(folder: Path, text: str) -> dict[str, str]:
    """What is said of each setting."""
    file = folder / "mine.toml"
    file.write_text(SIMULATED + text)
    return {f"{one.line}: {one.section}.{one.field}": one.text for one in mistakes_in(file)}


def test_what_is_wrong_of_several_settings_together_stands_beside_the_others(tmp_path: Path) -> None:
    said = checked(tmp_path, "[hand]\nspeed_m_s = 50.0\nmax_width_m = 8\n[execute]\ncontact_n = 100\n")
    assert list(said) == ["5: hand.speed_m_s", "6: hand.max_width_m", "8: execute.contact_n"]
    assert said["5: hand.speed_m_s"] == "must be within max_speed_m_s, 0.1 (given: 50.0)"


def test_nothing_is_said_of_a_setting_that_only_a_wrong_one_makes_wrong(tmp_path: Path) -> None:
    assert list(checked(tmp_path, "[hand]\nspeed_m_s = 0.5\nmax_speed_m_s = 'fast'\n")) == ["6: hand.max_speed_m_s"]


def test_joints_in_degrees_are_named_with_their_line_and_the_unit(tmp_path: Path) -> None:
    said = checked(tmp_path, "[arm]\ncapture_q_rad = [0, -26, 0, -105, 0, 79, 45]\n")
    assert "these look like degrees" in said["5: arm.capture_q_rad"]
    near = checked(tmp_path, "[arm]\ncapture_q_rad = [0, 0, 0, -3.5, 0, 1.4, 0.8]\n")
    assert "joint 4" in near["5: arm.capture_q_rad"] and "degrees" not in near["5: arm.capture_q_rad"]


@pytest.mark.parametrize(("center_m", "found"), [("[0.46, 0.0, 0.1]", True), ("[0.33, 0.19, 0.1]", False)])
def test_a_box_in_the_middle_of_the_pick_region_is_a_mistake(tmp_path: Path, center_m: str, found: bool) -> None:
    box = f"[[scene.obstacles]]\nname = 'lid'\ncenter_m = {center_m}\nsize_m = [0.1, 0.1, 0.1]\n"
    assert ("4: scene.obstacles.1" in checked(tmp_path, box)) is found


def test_a_file_without_a_mistake_has_none() -> None:
    assert mistakes_in(DEFAULT_STATION) == []


@pytest.mark.parametrize("name", ["sim", "lab", "bin"])
def test_what_is_shown_is_a_station_file_of_the_same_station(name: str) -> None:
    station = load_station(DEFAULT_STATION.with_stem(name))
    tree: dict[str, Any] = {}
    for setting, value in leaves(station).items():
        *path, leaf = setting.split(".")
        table = tree
        for part in path:
            table = table.setdefault(part, {})
        if value is not None:
            table[leaf] = tomllib.loads(f"x = {toml_value(value)}")["x"]
    assert Station.model_validate(tree) == station


@pytest.mark.parametrize("kind", Kind)
def test_a_new_station_file_has_no_mistake(tmp_path: Path, kind: Kind) -> None:
    file = tmp_path / "Line 2.toml"
    file.write_text(new_station(cell_id_of(file), kind))
    assert mistakes_in(file) == []
    station = load_station(file)
    assert (station.cell_id, station.simulated) == ("line-2", kind is not Kind.ROBOT)
    assert bool(station.scene.bins) == (kind is Kind.BIN)


def test_a_new_file_for_a_robot_asks_for_all_that_the_labs_asks_for() -> None:
    """Settings marked CHANGE in lab.toml are in the new file; `arm.capture_q_rad` may stay as it is."""
    lab, new = (DEFAULT_STATION.with_name("lab.toml")).read_text(), new_station("cell")
    marked = {number for number, line in enumerate(lab.splitlines(), start=1) if "CHANGE" in line}
    asked = {path for path, line in lines_of(lab).items() if line in marked and isinstance(path[-1], str)}
    assert len(asked) > 10 and asked - lines_of(new).keys() <= {("arm", "capture_q_rad")}


def test_an_editors_schema_has_every_table_with_its_words() -> None:
    schema = station_schema()
    hold = schema["$defs"]["VerifySettings"]["properties"]["hold_s"]
    assert hold["default"] == 3.0 and hold["description"]
    assert set(schema["properties"]) == set(Station.model_fields) and schema["additionalProperties"] is False
    told = [
        one
        for table in schema["$defs"].values()
        for one in table.get("properties", {}).values()
        if "description" in one
    ]
    assert len(told) > 150
