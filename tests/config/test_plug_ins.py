"""Plug-ins of other packages: what is listed of them, whose name counts, and the settings that each has of its own."""

from __future__ import annotations

import json
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from bus.errors import CellError, ConfigError, DeviceLost, DriverUnavailable, HandFault
from cell.cli.station.plug_in_mistakes import plug_in_mistakes
from cell.cli.station.plug_ins import drivers
from cell.nodes import starting, supervisor
from config.load import load_station, station_from
from config.mistakes import mistakes_in
from config.plug_ins import Group
from config.schema import Station
from drivers.interface import Hand, Reporting
from drivers.node.registry import GROUP, open_devices, open_node
from tests.dist_info import write_dist_info

_MODULE = """
from bus.errors import HandFault
from pydantic import BaseModel
from config.plug_ins import with_settings
from drivers.interface import Devices

class Settings(BaseModel, extra="forbid"):
    port: int
    baud: int = 9600

@with_settings(Settings)
def fine(station, settings):
    assert (settings.port, settings.baud) == (7, 9600)
    return Devices()

def plain(station):
    return Devices()

def no_devices(station):
    return None

def fails(station):
    raise OSError("no licence")

def quits(station):
    raise SystemExit(3)

class Broken:
    def state(self): raise RuntimeError("serial bug.")
    def move(self, width_m, speed_m_s): raise SystemExit(3)
    def readings(self): raise OSError("no bus")
    def stop(self): raise HandFault("stuck", "Loosen it.")
    def home(self): return None
    connect = close = grasp = stop

def broken(station):
    return Devices(hand=Broken())

def lacks(station):
    return Devices(hand=object())

class NoModel:
    Settings = "port"
"""
_POINTS = (
    *("fine", "plain", "no_devices", "fails", "quits", "broken", "lacks"),
    "missing=plug_in_that_lacks:open_devices",
    "nowhere=not_there:open_devices",
    "renamed=plug_in_for_tests:open_devices",
    "no_model=plug_in_for_tests:NoModel",
    "sim=plug_in_for_tests:plain",
    "twice=plug_in_for_tests:plain",
)


def install(folder: Path, name: str, *points: str) -> None:
    """A package of another maker: what its installer says of it."""
    lines = [one.replace("=", " = ") if "=" in one else f"{one} = plug_in_for_tests:{one}" for one in points]
    write_dist_info(folder, name, "1.0", {GROUP.name: lines})


@pytest.fixture(autouse=True)
def _packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "plug_in_for_tests.py").write_text(_MODULE)
    (tmp_path / "plug_in_that_lacks.py").write_text("import serial_x")
    install(tmp_path, "acme", *_POINTS)
    install(tmp_path, "other", "twice=plug_in_for_tests:plain")
    monkeypatch.syspath_prepend(tmp_path)


def station(driver: str, **settings: Any) -> Station:
    nodes = {
        "hand": {"driver": driver, "serves": ["hand"], "settings": settings},
        "rest": {"driver": "sim", "serves": ["arm", "camera"]},
    }
    return station_from({"nodes": nodes})


def test_a_driver_gets_the_settings_of_its_node_checked_and_with_its_defaults() -> None:
    assert open_node("hand", station("fine", port=7)).hand is None
    assert open_node("hand", station("plain")).hand is None


@pytest.mark.parametrize(
    ("driver", "settings", "said"),
    [
        ("fine", {"port": "x"}, r"nodes\.hand\.settings\.port: .*valid integer.* \(the driver 'fine' says\)"),
        ("fine", {}, r"nodes\.hand\.settings\.port: Field required"),
        ("fine", {"port": 7, "bauds": 1}, r"nodes\.hand\.settings\.bauds: Extra inputs.*settings: port, baud\."),
        ("plain", {"port": 7}, r"nodes\.hand\.settings\.port: the driver 'plain' has no settings"),
        ("sim", {"port": 7}, r"nodes\.hand\.settings\.port: the driver 'sim' has no settings"),
        ("no_model", {}, "is no pydantic model"),
        ("twice", {}, r"'twice' is brought by acme 1.0 and other 1.0\. Uninstall"),
        ("grippr", {}, r"Unknown driver 'grippr'\. nodes\.NAME\.driver is one of: broken, fails"),
    ],
)
def test_what_is_wrong_in_the_station_file_is_refused_with_table_and_field(
    driver: str, settings: dict[str, Any], said: str
) -> None:
    with pytest.raises(ConfigError, match=said):
        open_node("hand", station(driver, **settings))


@pytest.mark.parametrize(
    ("driver", "said"),
    [
        (
            "missing",
            r"'missing' cannot be loaded: ModuleNotFoundError: No module named 'serial_x'.*Install what acme 1",
        ),
        (
            "nowhere",
            r"No module named 'not_there'\. The entry point of acme 1\.0 is 'not_there:open_devices': correct it",
        ),
        ("renamed", r"no attribute 'open_devices'\. The entry point of acme 1\.0 is 'plug_in_for_tests:open_devices'"),
        ("fails", "'fails' does not start: OSError: no licence"),
        ("quits", r"'quits' does not start: SystemExit: 3\."),
        ("no_devices", "'no_devices' gave NoneType and no Devices"),
    ],
)
def test_a_driver_that_does_not_work_here_says_so(driver: str, said: str) -> None:
    with pytest.raises(DriverUnavailable, match=said):
        open_devices(driver, load_station())


def test_what_its_device_raises_is_named_and_no_defect_of_ours() -> None:
    """Errors of devices stay as they are; readings, which never raise, are none."""
    hand: Any = open_node("hand", station("broken")).hand
    for act, said in (
        (hand.state, "RuntimeError: serial bug"),
        (lambda: hand.move(0.0, 0.1), "SystemExit: 3"),
        (hand.home, "TypeError: home() returned NoneType, and it returns HandState"),
    ):
        with pytest.raises(DeviceLost) as failed:
            act()
        assert failed.value.text == f"The hand of driver 'broken' of package acme 1.0 failed: {said}."
        assert "defect" not in str(failed.value) and ".." not in str(failed.value)
    with pytest.raises(HandFault, match="Loosen it"):
        hand.stop()
    assert isinstance(hand, Hand) and isinstance(hand, Reporting) and hand.readings() == {}


def test_a_device_without_a_member_of_its_protocol_is_refused_with_that() -> None:
    with pytest.raises(DriverUnavailable, match=r"hand of driver 'lacks' of package acme 1\.0 has no 'connect'"):
        open_node("hand", station("lacks"))


def test_settings_are_part_of_the_recorded_station_and_can_be_overridden() -> None:
    recorded = json.loads(station("fine", port=7).model_dump_json())
    assert recorded["nodes"]["hand"]["settings"] == {"port": 7}
    again = station_from(recorded, ["nodes.hand.settings.baud=115200"])
    assert again.nodes["hand"].settings == {"port": 7, "baud": 115200}


def test_every_driver_is_listed_with_its_package_settings_and_error(capsys: pytest.CaptureFixture[str]) -> None:
    drivers(as_json=True)
    rows = [(row["name"], row["package"].partition(" ")[0], row) for row in json.loads(capsys.readouterr().out)]
    listed = {(name, package): row for name, package, row in rows}
    assert listed["fine", "acme"]["settings"]["baud"]["default"] == 9600
    assert "ModuleNotFoundError" in listed["missing", "acme"]["error"]
    assert listed["sim", "acme"]["error"] == "The name 'sim' is taken by vlad-cell."
    assert listed["sim", "vlad-cell"]["error"] == listed["fr3", "vlad-cell"]["error"] == ""
    assert "other 1.0 has the name 'twice', too" in listed["twice", "acme"]["error"]


def test_the_list_in_words_names_settings_with_their_defaults(capsys: pytest.CaptureFixture[str]) -> None:
    drivers()
    lines = capsys.readouterr().out
    assert "settings: port (required), baud = 9600" in lines and "acme 1.0" in lines


def test_no_package_takes_over_a_name_of_ours() -> None:
    assert open_devices("sim", load_station()).camera is not None


def test_a_group_says_what_it_is_for() -> None:
    with pytest.raises(CellError, match=r"Unknown thing 'x'\. a\.key is one of: ours\."):
        Group("vlad_cell.nothing", kind="thing", key="a.key", reserved=("ours",)).require("x")


def test_a_check_names_what_is_not_installed_and_each_setting_that_a_plug_in_refuses(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(
        "[nodes.hand]\ndriver = 'fine'\nserves = ['hand']\n[nodes.hand.settings]\nprt = 7\nbaud = 'fast'\n"
        "[nodes.sim]\ndriver = 'sims'\nserves = ['camera', 'arm']\n"
        "[perception]\ndetector = 'vald'\nmodel = 'gpt'\n"
    )
    found = {f"{one.section}.{one.field}": one for one in mistakes_in(file, plug_in_mistakes)}
    assert {name: one.line for name, one in found.items()} == {
        "nodes.hand.settings.port": 4,
        "nodes.hand.settings.prt": 5,
        "nodes.hand.settings.baud": 6,
        "nodes.sim.driver": 8,
        "perception.detector": 11,
        "perception.model": 12,
    }
    assert "the driver 'fine' says" in found["nodes.hand.settings.baud"].text
    assert "perception.detector is one of: vlad" in found["perception.detector"].advice


def test_settings_of_no_plug_in_are_a_mistake(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(
        "[nodes.sim]\ndriver = 'sim'\nserves = ['camera', 'arm', 'hand']\nsettings.port = 7\n"
        "[perception.settings]\nheadings = 36\n"
    )
    assert [(one.line, one.field) for one in mistakes_in(file, plug_in_mistakes)] == [(4, "port"), (6, "headings")]


def test_a_driver_that_never_serves_is_named_while_it_is_waited_for_and_in_the_end(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def stuck(name: str, of: Station) -> subprocess.Popen[str]:
        """A process that says nothing until its stdin closes."""
        command = [sys.executable, "-c", "input()"]
        return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, encoding="utf-8")

    monkeypatch.setattr(starting, "SLOW_S", 0.01)
    monkeypatch.setattr(supervisor, "START_TIMEOUT_S", 0.02)
    children = supervisor.Supervisor(station("plain"), on_exit=lambda name, code: None, spawn=stuck)
    with closing(children), pytest.raises(DriverUnavailable) as error:
        children.start()
    assert "The node 'hand' did not start within 0.02 s: its driver 'plain' of acme 1.0 does not" in error.value.text
    assert "node hand does not serve yet: waiting for its driver 'plain' of acme 1.0" in caplog.text
