"""The whole path as an operator runs it: one command, its daemon and node process, the recordings, and their replay."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from typer.testing import CliRunner

from bus.errors import Refused
from bus.session import Bus
from cell import client
from cell.cli.commands import command_line
from config.schema import Station
from drivers.remote import RemoteArm
from logs.mcap.reader import read_cycle

Cell = tuple[subprocess.Popen[str], Station]
InProcess = Callable[..., subprocess.CompletedProcess[str]]
GOLDEN = Path(__file__).parents[1] / "golden" / "cycle-schema4.mcap"
EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "trigger.py"


def _cell(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "cell", *arguments], capture_output=True, text=True, timeout=120, check=False
    )


@pytest.fixture(scope="module")
def lines(tmp_path_factory: pytest.TempPathFactory, new_endpoint: Callable[[], str]) -> list[dict[str, Any]]:
    """The lines of ``cell start --cycles 2 --json``, where an earlier process was killed in the middle of a cycle."""
    folder = tmp_path_factory.mktemp("recordings")
    (folder / "torn.mcap.part").write_bytes(GOLDEN.read_bytes()[:1_000_000])
    options = ["--set", f"bus.endpoint={new_endpoint()}", "--set", f"recording.folder={folder}"]
    done = _cell("start", "--cycles", "2", "--seed", "3", "--json", *options)
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_one_json_object_a_cycle(lines: list[dict[str, Any]]) -> None:
    assert len(lines) == 2 and lines[0]["object"] != lines[1]["object"]
    for line in lines:
        assert {"cycle_id", "object", "result", "code", "stages", "wall_s", "recording"} <= line.keys()
        assert line["result"] == "SUCCESS" and line["code"] is None
        assert list(line["stages"]) == ["capture", "detect", "plan", "execute", "verify", "deliver"]
        assert 0 < sum(line["stages"].values()) < line["wall_s"]


def test_what_an_earlier_process_left_is_whole_again(lines: list[dict[str, Any]]) -> None:
    recovered = Path(lines[0]["recording"]).parents[1] / "torn.mcap"
    cycle = read_cycle(recovered)
    assert cycle.metadata["result"] == "INTERRUPTED" and "detect" in cycle.stages and cycle.result is None
    assert not recovered.with_name("torn.mcap.part").exists()


def test_a_replay_is_equal(lines: list[dict[str, Any]], in_process: InProcess) -> None:
    for line in lines:
        done = in_process("replay", line["recording"], "--json")
        assert done.returncode == 0 and json.loads(done.stdout)["equal"] is True
        assert set(json.loads(done.stdout)["stages"]) == {"detect", "plan", "verify"}


def test_a_what_if_names_the_first_difference(lines: list[dict[str, Any]], in_process: InProcess) -> None:
    done = in_process("replay", lines[0]["recording"], "--json", "--set", "perception.compliance=1.5")
    first = json.loads(done.stdout)["first_difference"]
    assert done.returncode == 1
    assert (first["stage"], first["field"], first["unit"]) == ("detect", "rectangles[0].width_px", "px")
    assert first["replayed"] == pytest.approx(1.5 * first["recorded"])


def test_the_recording_opens_with_the_plain_mcap_packages(lines: list[dict[str, Any]]) -> None:
    seen: dict[str, Any] = {}
    with open(lines[0]["recording"], "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message in reader.iter_messages():
            if channel.message_encoding == "json":
                assert schema is not None and schema.encoding == "jsonschema"
                seen[channel.topic] = json.loads(message.data)
        for _schema, channel, _message, decoded in reader.iter_decoded_messages(
            topics=["/camera/color", "/camera/depth", "/arm/state", "/tf"]
        ):
            seen[channel.topic] = decoded
        attachments = [attachment.name for attachment in reader.iter_attachments()]
    assert seen["/camera/color"].format == "jpeg" and seen["/camera/depth"].encoding == "16UC1"
    assert len(seen["/arm/state"].joints) == 7
    assert seen["/cycle/result"]["result"] == "SUCCESS"
    assert {f"/cycle/{stage}" for stage in lines[0]["stages"]} <= seen.keys()
    assert {"/state", "/arm/execute/query", "/arm/execute/reply", "/hand/grasp/reply"} <= seen.keys()
    assert {"station.json", "calibration.json", "prompts/00-reason.txt", "replies/00-reason.txt"} <= set(attachments)


def test_show_and_cycles_tell_what_was_recorded(lines: list[dict[str, Any]], in_process: InProcess) -> None:
    shown = json.loads(in_process("show", lines[0]["recording"], "--json").stdout)
    assert shown["result"]["cycle_id"] == lines[0]["cycle_id"] and shown["metadata"]["seed"] == "3"
    listed = in_process("cycles", str(Path(lines[0]["recording"]).parent), "--json").stdout.splitlines()
    assert [json.loads(line)["cycle_id"] for line in listed] == [line["cycle_id"] for line in reversed(lines)]
    asked_by = [line["asked_by"] for line in (shown, *lines, *map(json.loads, listed))]
    assert set(asked_by) == {"terminal"}, "who asked, of every pick of a batch"


# --- a daemon that stays ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pace() -> float:
    """Twice real time: slow enough to stop a motion in the midst of it."""
    return 2.0


def test_other_processes_command_the_daemon(shared_daemon: Cell, shared_options: list[str]) -> None:
    status = json.loads(_cell("status", "--json", *shared_options).stdout)
    assert (status["state"], list(status["health"]["nodes"])) == ("Stopped", ["sim"])
    refused = _cell("pick", "--json", *shared_options)
    assert refused.returncode == 3
    assert json.loads(refused.stdout)["code"] == "WRONG_STATE" and "cell reset" in refused.stderr
    assert _cell("reset", *shared_options).returncode == 0
    picked = _cell("pick", "--json", "--object", "bottle", *shared_options)
    assert picked.returncode == 0 and json.loads(picked.stdout)["object"] == "bottle"
    unknown = _cell("pick", "--object", "unicorn", "--json", *shared_options)
    assert unknown.returncode == 3 and json.loads(unknown.stdout)["code"] == "UNKNOWN_OBJECT"
    assert "'unicorn'" in unknown.stderr and "bottle, controller, cup, drone, spatula" in unknown.stderr
    assert json.loads(_cell("status", "--json", *shared_options).stdout)["state"] == "Complete"


def test_a_stop_in_motion_ends_the_cycle_and_the_motion(shared_daemon: Cell, shared_options: list[str]) -> None:
    _, station = shared_daemon
    with client.connect(station) as cell:
        cell.command("reset")
        cell.wait_for_state({"Idle"}, 60)
        cycle_id = cell.command("pick").cycle_id
        give_up_s = time.monotonic() + 60
        while cell.state().stage != "execute":
            assert time.monotonic() < give_up_s
            time.sleep(0.02)
        time.sleep(0.3)  # somewhere in the transit
        _in_process("stop", *shared_options)
        result = cell.wait_for_result(cycle_id, 60)
        assert (result.result, result.code) == ("ABORTED", "STOPPED")
        assert Path(result.recording).is_file()
        assert cell.state().state == "Stopped" and "reset" in cell.state().available
        cell.command("reset")  # and it can go on
        cell.wait_for_state({"Idle"}, 60)


def _children(process: subprocess.Popen[str]) -> list[int]:
    tasks = Path(f"/proc/{process.pid}/task").glob("*/children")
    return [int(pid) for task in tasks for pid in task.read_text().split()]


def test_a_killed_node_aborts_with_its_name(
    shared_daemon: Cell,
) -> None:
    process, station = shared_daemon
    for pid in _children(process):
        os.kill(pid, signal.SIGKILL)
    with client.connect(station) as cell:
        with suppress(Refused):  # it has noticed
            cell.command("reset")
        state = cell.wait_for_state({"Aborted"}, 60)
    assert "sim" in state.reason


def test_a_plain_zenoh_program_triggers_a_pick(shared_daemon: Cell) -> None:
    _, station = shared_daemon
    source = EXAMPLE.read_text().replace("tcp/127.0.0.1:7447", station.bus.endpoint)
    assert station.bus.endpoint in source
    done = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, timeout=90, check=True)
    assert "'result': 'SUCCESS'" in done.stdout, done.stdout


def _in_process(*arguments: str) -> str:
    """Return what a ``cell`` command prints; run here, a new process would miss the motion."""
    done = CliRunner().invoke(command_line(), list(arguments), catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.output


def test_a_held_cycle_rests_and_goes_on_to_success(shared_daemon: Cell, shared_options: list[str]) -> None:
    _, station = shared_daemon
    with client.connect(station) as cell, Bus.join(station.cell_id, station.bus.endpoint) as bus:
        arm = RemoteArm(bus, station.bus.ask_timeout_s)
        arm.connect()
        cell.command("reset")
        cell.wait_for_state({"Idle"}, 60)
        with pytest.raises(Refused, match="not possible while the cell is Idle"):
            cell.command("hold")
        cycle_id = cell.command("pick").cycle_id
        give_up_s = time.monotonic() + 60
        while np.abs(arm.state().dq_rad_s).max() < 0.3:
            assert time.monotonic() < give_up_s
            time.sleep(0.005)
        assert _in_process("hold", *shared_options).startswith("Held by hold-")
        while np.abs((held := arm.state()).dq_rad_s).max() >= 1e-3:
            assert time.monotonic() < give_up_s
        np.testing.assert_array_equal(arm.state().q_rad, held.q_rad)
        shown = _in_process("status", *shared_options)
        assert shown.startswith("Held ") and "available: stop, abort, unhold" in shown
        assert cell.state().stage != ""
        np.testing.assert_array_equal(arm.state().q_rad, held.q_rad)
        assert _in_process("unhold", *shared_options).strip() in ("Execute", "Completing")
        result = cell.wait_for_result(cycle_id, 60)
    assert result.result == "SUCCESS", result.reason
