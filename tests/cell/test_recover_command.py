"""`cell recover` on torn files: one line a file, and an exit code that says whether anything is lost."""

from __future__ import annotations

import json
from pathlib import Path

from typer.testing import CliRunner

from bus.codec import encode
from bus.messages import HandState
from bus.topics import encoding_of
from cell.cli.commands import command_line
from logs.mcap.recorder import Recorder


def _torn(path: Path) -> str:
    recorder = Recorder(path, metadata={"cycle_id": path.stem}, clock=lambda: 1)
    hand = HandState(stamp_ns=1, width_m=0.04, is_moving=False, is_homed=True)
    recorder.write("hand/state", encoding_of(HandState), encode(hand), log_time_ns=1)
    recorder.flush()
    recorder.abandon()
    return f"{path}.part"


def test_every_file_is_recovered_and_said(tmp_path: Path) -> None:
    done = CliRunner().invoke(command_line(), ["recover", _torn(tmp_path / "a.mcap"), _torn(tmp_path / "b.mcap")])
    assert done.exit_code == 0 and done.output.count("1 messages kept") == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mcap", "b.mcap"]


def test_of_a_folder_every_torn_file_is_recovered(tmp_path: Path) -> None:
    _torn(tmp_path / "a.mcap")
    done = CliRunner().invoke(command_line(), ["recover", str(tmp_path)])
    assert done.exit_code == 0 and "1 messages kept" in done.output
    again = CliRunner().invoke(command_line(), ["recover", str(tmp_path)])
    assert again.exit_code == 0 and again.output == "Nothing is torn there.\n"


def test_json_tells_programs_the_same(tmp_path: Path) -> None:
    done = CliRunner().invoke(command_line(), ["recover", "--json", _torn(tmp_path / "a.mcap")])
    said = json.loads(done.output)
    assert (said["messages"], said["ended"], said["lost"]) == (1, "torn", False)


def test_a_file_that_cannot_be_recovered_does_not_keep_the_others_from_it(tmp_path: Path) -> None:
    (tmp_path / "bad.mcap.part").write_bytes(b"no MCAP")
    done = CliRunner().invoke(command_line(), ["recover", str(tmp_path / "bad.mcap.part"), _torn(tmp_path / "a.mcap")])
    assert done.exit_code == 2 and "nothing that can be recovered" in done.output
    assert (tmp_path / "a.mcap").is_file()


def test_what_is_lost_is_an_exit_code_of_its_own(tmp_path: Path) -> None:
    part = Path(_torn(tmp_path / "a.mcap"))
    whole = tmp_path / "whole.mcap"
    whole.write_bytes(part.read_bytes()[:-1])
    assert CliRunner().invoke(command_line(), ["recover", str(whole)]).exit_code == 1
