"""``cell compare``, ``alike`` and ``groups`` as an engineer uses them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from bus.errors import ConfigError
from cell.cli.commands import command_line
from logs.mcap.recorder import Recorder

GOLDEN = Path(__file__).parents[1] / "golden"
THREE, FOUR = (str(GOLDEN / f"cycle-schema{number}.mcap") for number in (3, 4))


def _cell(*arguments: str) -> Result:
    return CliRunner().invoke(command_line(), arguments)


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    """What it was: three of four failed; what it is now: none of four."""
    before, after = tmp_path / "before", tmp_path / "after"
    for number in range(4):
        bad = {"result": "FAILED", "code": "NO_GRASP", "reason": "Too wide."} if number else {"result": "SUCCESS"}
        _recorded(before, f"20260101T08000000{number}", bad)
        _recorded(after, f"20260102T08000000{number}", {"result": "SUCCESS"})
    return before, after


def _recorded(folder: Path, name: str, result: dict[str, str]) -> None:
    recorder = Recorder(folder / f"{name}.mcap", metadata={"cycle_id": name}, clock=lambda: 1)
    recorder.attach("station.json", "application/json", b"{}")
    recorder.close(result)


def test_two_cycles_are_compared_and_the_page_is_written(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    said = _cell("compare", THREE, FOUR, "-o", str(page))
    assert said.exit_code == 0 and "first input of" in said.stdout and "motion " in said.stdout and page.is_file()
    found = json.loads(_cell("compare", THREE, FOUR, "--json").stdout)
    assert found["first"]["kind"] == "input" and found["counts"]["decision"] and found["motion"]
    assert "0 values differ" in _cell("compare", FOUR, FOUR).stdout


def test_two_folders_are_compared_with_intervals(folders: tuple[Path, Path]) -> None:
    before, after = map(str, folders)
    text = _cell("compare", before, after).stdout
    assert text.startswith("B is better: +75.0 points") and "code NO_GRASP" in text
    found = json.loads(_cell("compare", before, after, "--json").stdout)
    assert (found["success"]["a"]["n"], found["success"]["b"]["of"]) == (1, 4)
    assert found["success"]["difference"]["low"] > 0
    assert isinstance(_cell("compare", before, FOUR).exception, ConfigError)
    assert "no folder" in str(_cell("compare", before, before + "/none").exception)


def test_failures_are_grouped_and_a_cycle_has_neighbours(folders: tuple[Path, Path]) -> None:
    before = str(folders[0])
    text = _cell("groups", before, "--failed").stdout
    assert "3  3 cycles ended NO_GRASP" in text and "Too wide." in text
    (group,) = (json.loads(line) for line in _cell("groups", before, "--failed", "--json").stdout.splitlines())
    assert group["count"] == 3 and len(group["examples"]) == 3
    assert _cell("groups", before).stdout == text, "nothing but failures is grouped"
    one = str(folders[0] / "20260101T080000001.mcap")
    found = [json.loads(line) for line in _cell("alike", one, "--json").stdout.splitlines()]
    assert [cycle["code"] for cycle in found] == ["NO_GRASP", "NO_GRASP", ""]
    assert found[0]["distance"] == 0.0 < found[2]["distance"]
    assert "the same: how it ended" in _cell("alike", one).stdout
