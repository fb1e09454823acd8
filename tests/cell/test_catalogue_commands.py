"""``cell cycles --summary``, ``query``, ``label`` and ``catalogue rebuild`` as an operator uses them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from bus.errors import CatalogueError, ConfigError, RecordingError
from cell.cli.commands import command_line
from logs.mcap.recorder import Recorder

EARLY, LATE = "20260101T080000000", "20260101T120000000"


@pytest.fixture
def station(tmp_path: Path) -> list[str]:
    """``--config`` of a station with one picked and one failed cycle."""
    folder = tmp_path / "recordings"
    _recorded(folder, EARLY, {"result": "SUCCESS"})
    _recorded(folder, LATE, {"result": "FAILED", "code": "NO_GRASP", "reason": "Too wide."})
    path = tmp_path / "station.toml"
    sim = (Path(__file__).parents[2] / "config" / "sim.toml").read_text()
    path.write_text(f"{sim}\n[recording]\nfolder = '{folder}'\n")
    return ["--config", str(path)]


def _recorded(folder: Path, name: str, result: dict[str, str]) -> None:
    recorder = Recorder(folder / name[:4] / f"{name}.mcap", metadata={"cycle_id": name}, clock=lambda: 1)
    recorder.attach("station.json", "application/json", b"{}")
    recorder.close(result)


def _cell(*arguments: str) -> Result:
    return CliRunner().invoke(command_line(), arguments)


def test_a_summary_has_each_figure_with_its_definition(station: list[str]) -> None:
    text = _cell("cycles", "--summary", *station).stdout
    assert "50.0 %" in text and "Share of the picks that ended in SUCCESS." in text and "NO_GRASP: 0.0 s" in text
    said = json.loads(_cell("cycles", "--summary", "--json", "--day", "2026-01", *station).stdout)
    assert (said["picks"], said["success"], said["infeasible"]) == (2, 0.5, 0.5) and said["definitions"]
    assert isinstance(_cell("cycles", "--summary", "--failed", *station).exception, ConfigError)


def test_a_summary_counts_what_was_deleted(station: list[str]) -> None:
    assert _cell("prune", *station, "--set", "recording.keep_days=1").exit_code == 0
    assert json.loads(_cell("cycles", "--summary", "--json", *station).stdout)["picks"] == 2
    assert EARLY not in _cell("cycles", *station).stdout


def test_a_query_is_printed_as_a_table_csv_or_json(station: list[str]) -> None:
    query = "query", "SELECT code, count(*) AS n FROM cycles GROUP BY code"
    assert _cell(*query, *station).stdout.split() == ["code", "n", "1", "NO_GRASP", "1"]
    assert _cell(*query, "--csv", *station).stdout.splitlines() == ["code,n", ",1", "NO_GRASP,1"]
    rows = [json.loads(line) for line in _cell(*query, "--json", *station).stdout.splitlines()]
    assert rows == [{"code": "", "n": 1}, {"code": "NO_GRASP", "n": 1}]


def test_a_query_that_cannot_be_answered_is_an_error_of_usage(station: list[str]) -> None:
    for query in (("DROP TABLE cycle",), ("SELECT 1 UNION SELECT 2", "--rows", "1")):
        error = _cell("query", *query, *station).exception
        assert isinstance(error, CatalogueError) and error.exit_code == 2
    assert isinstance(_cell("query", "SELECT 1", "--csv", "--json", *station).exception, ConfigError)


def test_a_label_is_shown_and_can_be_asked_for(station: list[str], tmp_path: Path) -> None:
    assert _cell("label", "T12", "bad", "the", "light was off", "--who", "anna", *station).exit_code == 0
    assert _cell("label", LATE, "A note.", "--who", "ben", *station).exit_code == 0
    shown = _cell("show", LATE, *station).stdout
    assert "bad by anna" in shown and ": the light was off" in shown and "note by ben" in shown
    assert [one["who"] for one in json.loads(_cell("show", LATE, "--json", *station).stdout)["labels"]] == [
        "anna",
        "ben",
    ]
    assert "labelled  " not in _cell("show", EARLY, *station).stdout
    asked = _cell("query", "SELECT cycle_id, label, notes FROM cycles WHERE label = 'bad'", "--csv", *station).stdout
    assert asked.splitlines()[1:] == [f"{LATE},bad,2"]


def test_a_label_that_says_nothing_or_of_no_recording_is_refused(station: list[str], tmp_path: Path) -> None:
    assert isinstance(_cell("label", LATE, " ", *station).exception, ConfigError)
    for nothing in ("T13", str(tmp_path / "recordings" / "none.mcap")):
        assert isinstance(_cell("label", nothing, "bad", *station).exception, RecordingError)


def test_a_rebuild_says_what_it_read(station: list[str]) -> None:
    for options, read in (((), 2), ((), 0), (("--anew",), 2)):
        said = json.loads(_cell("catalogue", "rebuild", "--json", *options, *station).stdout)
        assert (said["rows"], said["read"], said["torn"]) == (2, read, 0)
    assert "2 cycles, 0 read" in _cell("catalogue", "rebuild", *station).stdout


def test_a_long_list_has_a_line_for_every_cycle(station: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    whole = _cell("cycles", *station).stdout.splitlines()
    monkeypatch.setattr("cell.cli.recorded.cycles._AT_ONCE", 1)
    assert [line.split() for line in _cell("cycles", *station).stdout.splitlines()] == [line.split() for line in whole]
