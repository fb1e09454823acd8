"""A recording made with packages that are not here: it is read, and a replay says what is missing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from typer.testing import CliRunner, Result

from bus.errors import ConfigError, NotHere
from cell.cli.commands import command_line
from cell.daemon.runinfo import run_info
from cell.replay.replay import Request, replay
from config.load import load_station
from logs.mcap.reader import PLUG_INS, read_cycle
from planning.robot import Robot
from tests.docs.example_packages import install
from vlad_cell import read_cycle as cycle_of

GOLDEN = Path(__file__).parents[1] / "golden" / "cycle-schema4.mcap"
DETECTOR = {"perception.detector": "acme", "perception.settings": {"headings": 36}}
GRIPPER = {"nodes": {"sim": {"driver": "acme_gripper", "serves": ["camera", "arm", "hand"], "settings": {"port": "x"}}}}
ACME = '{"perception.detector": "acme-detector 0.1.0"}'


def copy_of(file: Path, changed: dict[str, Any], plug_ins: str | None = None) -> Path:
    """A recording as the golden one, of a station with these settings changed, and with this metadata."""
    with GOLDEN.open("rb") as source, file.open("wb") as target:
        reader, writer = make_reader(source), Writer(target, compression=CompressionType.NONE)
        writer.start()
        for one in reader.iter_metadata():
            more = {PLUG_INS: plug_ins} if plug_ins and one.name == "run" else {}
            writer.add_metadata(one.name, {**one.metadata, **more})
        for file_in in reader.iter_attachments():
            data = _station(file_in.data, changed) if file_in.name == "station.json" else file_in.data
            writer.add_attachment(file_in.create_time, file_in.log_time, file_in.name, file_in.media_type, data)
        channels: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, number)
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence
            )
        writer.finish()  # type: ignore[no-untyped-call]
    return file


def _station(data: bytes, changed: dict[str, Any]) -> bytes:
    tree = json.loads(data)
    for key, value in changed.items():
        *path, leaf = key.split(".")
        table = tree
        for part in path:
            table = table[part]
        table[leaf] = value
    return json.dumps(tree).encode()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a recording of another package's detector, and one of another package's driver."""
    folder = tmp_path_factory.mktemp("recordings")
    copy_of(folder / "detector.mcap", DETECTOR, ACME)
    copy_of(folder / "driver.mcap", GRIPPER)
    return folder


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot(load_station())


def cell(*arguments: object) -> Result:
    return CliRunner().invoke(command_line(), [str(one) for one in arguments])


@pytest.mark.parametrize("name", ["detector", "driver"])
def test_it_is_read_shown_and_reported_as_any_other(folder: Path, tmp_path: Path, name: str) -> None:
    file = folder / f"{name}.mcap"
    shown = cell("show", file)
    assert shown.exit_code == 0 and shown.stdout.startswith("SUCCESS") and "acme" in shown.stdout
    assert cell("report", file, "-o", tmp_path / "page.html").exit_code == 0
    cycle = cycle_of(file)
    assert cycle.result == "SUCCESS" and cycle.grasps and cycle.color.size and cycle.picture().rgb.size
    assert cycle.station.cell_id == "sim"


def test_it_is_listed_as_any_other(folder: Path) -> None:
    listed = cell("cycles", folder, "--json")
    assert listed.exit_code == 0 and listed.stdout.count("SUCCESS") >= 2 and "unreadable" not in listed.stdout


def test_a_replay_needs_no_driver(folder: Path, robot: Robot) -> None:
    assert replay(read_cycle(folder / "driver.mcap"), Request(only="verify"), lambda _: robot).equal


def test_a_replay_says_which_package_is_missing_and_what_to_install(folder: Path, robot: Robot) -> None:
    record = read_cycle(folder / "detector.mcap")
    with pytest.raises(
        NotHere, match=r"is whole.*the detector 'acme' of acme-detector 0.1.0, which is not installed"
    ) as said:
        replay(record, Request(), lambda _: robot)
    assert "uv pip install acme-detector==0.1.0" in said.value.advice and "`cell show`" in said.value.advice
    del record.metadata[PLUG_INS]  # as in recordings from before it was recorded
    with pytest.raises(NotHere, match=r"no installed package brings it.*entry point 'acme' of vlad_cell\.detectors"):
        replay(record, Request(), lambda _: robot)
    other = Request.of(["perception.detector=zebra"], None, None)
    with pytest.raises(ConfigError, match="Unknown detector 'zebra'"):
        replay(record, other, lambda _: robot)


def test_in_a_folder_it_is_not_unreadable_but_not_to_be_run_here(folder: Path) -> None:
    done = cell("replay", folder, "--only", "verify", "--json")
    said = json.loads(done.stdout)
    assert (done.exit_code, said["cycles"], said["equal"], said["unreadable"]) == (2, 2, 1, {})
    ((file, why),) = said["not_here"].items()
    assert file == str(folder / "detector.mcap") and "acme-detector" in why


def test_what_the_robot_s_description_is_missing_for_is_said_too(folder: Path) -> None:
    gone = load_station(Path(__file__).parents[2] / "examples" / "six_joint_arm" / "station.toml").model_dump(
        mode="json"
    )
    record = read_cycle(folder / "driver.mcap")
    record.station.update(gone, robot={**gone["robot"], "urdf": "/nowhere/arm.urdf"})
    with pytest.raises(NotHere, match=r"/nowhere/arm\.urdf cannot be read.*--set robot\.urdf=FILE"):
        replay(record, Request())


def test_a_recording_says_which_packages_it_was_made_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, tmp_path, "detector", "goal_model", "hand_driver")
    used = ["perception.detector=acme", "perception.model=acme", "nodes.sim.driver=acme_gripper"]
    assert json.loads(run_info(load_station(None, used), "c")[PLUG_INS]) == {
        "perception.detector": "acme-detector 0.1.0",
        "perception.model": "acme-model 0.1.0",
        "nodes.sim.driver": "acme-gripper 0.1.0",
    }
    assert run_info(load_station(), "c")[PLUG_INS] == "{}", "ours need no other package"
