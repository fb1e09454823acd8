"""``cell cycles``, ``show`` and ``report`` as an operator uses them, on recordings made for the tests."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from bus import topics
from bus.codec import encode
from bus.codes import Code
from bus.errors import ConfigError, RecordingError
from bus.messages import CycleResult, GraspHints, Job
from bus.topics import encoding_of
from cell.cli.commands import command_line
from logs.mcap.reader import read_cycle
from logs.mcap.recorder import Recorder

EARLY, LATE = "20260101T080000000", "20260101T120000000"


@pytest.fixture
def station(tmp_path: Path) -> list[str]:
    """``--config`` of a station whose recordings folder holds one picked and one failed cycle."""
    folder = tmp_path / "recordings"
    _recorded(folder, EARLY, {"result": "SUCCESS", "reason": "Held."})
    _recorded(folder, LATE, {"result": "FAILED", "code": Code.NO_GRASP, "reason": "Too wide."})
    text = (Path(__file__).parents[2] / "config" / "sim.toml").read_text()
    path = tmp_path / "station.toml"
    path.write_text(f"{text}\n[recording]\nfolder = '{folder}'\n")
    return ["--config", str(path)]


def _recorded(folder: Path, cycle_id: str, result: dict[str, str]) -> None:
    recorder = Recorder(folder / f"{cycle_id}.mcap", metadata={"cycle_id": cycle_id, "commit": "abc"}, clock=lambda: 1)
    recorder.attach("station.json", "application/json", b"{}")
    recorder.close(result)


def _cell(*arguments: str) -> Result:
    return CliRunner().invoke(command_line(), arguments)


def test_cycles_are_listed_newest_first_one_a_line(station: list[str]) -> None:
    head, late, early = _cell("cycles", *station).stdout.splitlines()
    assert head.split() == ["cycle", "result", "code", "object", "time", "try", "why"]
    assert late.split() == [LATE, "FAILED", "NO_GRASP", "1", "Too", "wide."]
    assert early.split()[:2] == [EARLY, "SUCCESS"]


def test_what_was_not_found_is_listed_as_it_was_asked_for(tmp_path: Path) -> None:
    result = CycleResult(
        cycle_id=LATE, object="spatula", result="FAILED", code=Code.TARGET_NOT_FOUND, stages={}, wall_s=1.0,
        reason="Nothing here is 'purple'.", recording="",
    )  # fmt: skip
    recorder = Recorder(tmp_path / f"{LATE}.mcap", metadata={"cycle_id": LATE}, clock=lambda: 1)
    recorder.attach("station.json", "application/json", b"{}")
    recorder.write(topics.RESULT.key, encoding_of(topics.RESULT.says), encode(result), log_time_ns=1)
    recorder.close({"result": result.result, "code": Code.TARGET_NOT_FOUND, "reason": result.reason})
    _, line = _cell("cycles", str(tmp_path)).stdout.splitlines()
    assert line.split()[1:4] == ["FAILED", "TARGET_NOT_FOUND", "'purple'"] and "spatula" not in line
    assert json.loads(_cell("cycles", str(tmp_path), "--json").stdout)["object"] == "spatula", "as it is recorded"


@pytest.mark.parametrize(
    "options", [("--failed",), ("--code", "NO_GRASP"), ("--last", "1"), ("--day", "2026-01-01", "--last", "1")]
)
def test_cycles_are_filtered(station: list[str], options: tuple[str, ...]) -> None:
    (line,) = _cell("cycles", *station, "--json", *options).stdout.splitlines()
    assert json.loads(line)["cycle_id"] == LATE


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--day", "2026-13-45"), "'2026-13-45' is no day. A day is today, 2026-11-28, 2026-11 or 2026 (UTC)."),
        (("--day", "tomorrow"), "'tomorrow' is no day."),
        (("--day", "20261128", "--summary"), "'20261128' is no day."),
        (("--code", "NO_GRASPS"), "There is no code 'NO_GRASPS'. Did you mean NO_GRASP?"),
    ],
)
def test_what_no_cycle_can_have_is_refused_and_not_answered_with_none(
    station: list[str], options: tuple[str, ...], said: str
) -> None:
    refused = _cell("cycles", *station, *options).exception
    assert isinstance(refused, ConfigError) and said in str(refused)


def test_show_takes_a_part_of_an_id_and_says_why(station: list[str]) -> None:
    done = _cell("show", "T12", *station)
    assert done.exit_code == 0
    assert "FAILED: Too wide." in done.stdout and f"{LATE}.mcap" in done.stdout and "abc" in done.stdout
    assert json.loads(_cell("show", LATE, *station, "--json").stdout)["metadata"]["commit"] == "abc"


@pytest.mark.parametrize(
    ("metadata", "said"),
    [
        ({"vlad-cell": "0.5.0", "commit": "unknown"}, "version 0.5.0"),
        ({"vlad-cell": "0.5.0", "commit": "abc"}, "version 0.5.0, commit abc"),
        ({}, "an unknown version"),
    ],
)
def test_show_names_what_made_a_recording(tmp_path: Path, metadata: dict[str, str], said: str) -> None:
    path = tmp_path / f"{LATE}.mcap"
    recorder = Recorder(path, metadata={"cycle_id": LATE, **metadata}, clock=lambda: 1)
    recorder.attach("station.json", "application/json", b"{}")
    recorder.close({"result": "SUCCESS"})
    told = " ".join(_cell("show", str(path)).stdout.split())
    assert told.endswith(f"made by {said}")


def test_what_a_job_changed_stands_under_the_job(monkeypatch: pytest.MonkeyPatch) -> None:
    path = Path(__file__).parents[1] / "golden" / "cycle-schema4.mcap"
    cycle = read_cycle(path)
    job = Job(job_id="gently", grasp=GraspHints(max_force_n=0.5))
    station = {**cycle.station, "hand": {**cycle.station["hand"], "grasp_force_n": 0.5}}
    gently = replace(cycle, station=station, attempt=cycle.attempt.model_copy(update={"job": job}))
    monkeypatch.setattr("cell.cli.recorded.show.read_cycle", lambda _: gently)
    lines = [line.strip() for line in _cell("show", str(path)).stdout.splitlines()]
    asked = lines.index("job         gently")
    assert lines[asked + 1 : asked + 3] == ["grasp       max_force_n 0.5", "by the job  hand.grasp_force_n = 0.5"]
    assert not any("grasp_force_n" in line for line in lines[:asked])
    told = json.loads(_cell("show", str(path), "--json").stdout)
    assert told["changed_by_job"] == {"hand.grasp_force_n": "0.5"} and "hand.grasp_force_n" not in told["changed"]


def test_a_cycle_that_is_not_there_is_named(station: list[str]) -> None:
    for command in ("show", "report", "replay"):
        error = _cell(command, "412", *station).exception
        assert isinstance(error, RecordingError) and "no cycle 412" in error.text


def test_a_report_lies_beside_its_recording_or_where_it_is_asked_for(station: list[str], tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    assert _cell("report", LATE, *station, "--output", str(page)).stdout.split() == [str(page)]
    assert _cell("report", LATE, *station).stdout.split() == [str(tmp_path / "recordings" / f"{LATE}.html")]
    assert "Too wide." in page.read_text()


def test_a_folder_gets_a_page_a_cycle_and_one_a_day(station: list[str], tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    assert _cell("report", str(folder)).stdout.split() == [str(folder / "index.html")]
    assert {path.name for path in folder.glob("*.html")} == {f"{EARLY}.html", f"{LATE}.html", "index.html"}
    with pytest.raises(ConfigError, match="--output"):
        raise _cell("report", str(folder), "-o", str(tmp_path / "x.html")).exception or AssertionError
