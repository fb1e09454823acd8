"""`--folder` names the recordings folder of every command that reads or keeps recordings, and means the same in all."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cell.cli.commands import COMMANDS, command
from logs.catalogue.labels import read_labels
from logs.mcap.recorder import Recorder

Run = Callable[..., subprocess.CompletedProcess[str]]
CYCLE, OTHER = "20261128T101500000", "20261128T101600000"
OF_ALL = ("cycles", "query", "groups", "catalogue rebuild", "prune", "export lerobot", "export grasps")
OF_ONE = ("show", "label", "report", "replay", "alike", "compare")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of recordings that is no station's."""
    for cycle_id in (CYCLE, OTHER):
        path = tmp_path / "kept" / "2026-11-28" / f"{cycle_id}.mcap"
        recorder = Recorder(path, metadata={"cycle_id": cycle_id}, clock=lambda: 1)
        recorder.attach("station.json", "application/json", b"{}")
        recorder.close({"result": "FAILED", "code": "NO_GRASP", "reason": "Too wide."})
    return tmp_path / "kept"


def _made(name: str) -> Any:
    first, _, second = name.partition(" ")
    made: Any = command(first)
    return made.commands[second] if second else made


@pytest.mark.parametrize("name", [*OF_ALL, *OF_ONE])
def test_every_command_of_recordings_has_the_option_with_the_same_words(name: str) -> None:
    ours, of_cycles = (next(one for one in _made(of).params if "--folder" in one.opts) for of in (name, "cycles"))
    assert (ours.help, ours.metavar, ours.show_default) == (of_cycles.help, of_cycles.metavar, of_cycles.show_default)


def test_no_other_command_uses_the_word_for_something_else() -> None:
    inner = {f"{name} {one}" for name in COMMANDS for one in getattr(command(name), "commands", {})}
    having = {name for name in {*COMMANDS, *inner} if any("--folder" in one.opts for one in _made(name).params)}
    assert having == {*OF_ALL, *OF_ONE, "tour"}, "tour: where its recordings go"


@pytest.mark.parametrize(
    "words",
    [
        ("cycles",),
        ("groups",),
        ("catalogue", "rebuild"),
        ("query", "SELECT count(*) FROM cycles"),
        ("prune", "--dry-run"),
    ],
    ids=" ".join,
)
def test_it_names_the_folder_that_is_worked_in(in_process: Run, folder: Path, words: tuple[str, ...]) -> None:
    named = in_process(*words, "--folder", str(folder))
    assert named.returncode == 0, named.stderr
    if words[0] != "query":
        assert (
            in_process(*words, str(folder)).stdout.split(" read in")[0][:20] == named.stdout.split(" read in")[0][:20]
        )
        twice = in_process(*words, str(folder), "--folder", str(folder.parent))
        assert (twice.returncode, "Two folders are named" in twice.stderr) == (2, True)
    missing = in_process(*words, "--folder", str(folder / "nowhere"))
    assert (missing.returncode, "There is no folder" in missing.stderr) == (2, True)


def test_a_cycle_is_looked_for_in_it_and_its_label_is_kept_there(in_process: Run, folder: Path) -> None:
    assert "Too wide." in in_process("show", CYCLE, "--folder", str(folder)).stdout
    assert in_process("label", CYCLE, "good", "--folder", str(folder)).returncode == 0
    assert [one.cycle_id for one in read_labels(folder)] == [CYCLE]
    lacking = in_process("show", "20200101", "--folder", str(folder))
    assert lacking.returncode == 2 and "--folder" in lacking.stderr
    assert "no cycle 20200101" in lacking.stderr


def test_all_of_a_folder_and_one_cycle_of_it_are_not_mixed_up(in_process: Run, folder: Path) -> None:
    for words in (("report", str(folder)), ("replay", str(folder)), ("compare", str(folder), str(folder))):
        done = in_process(*words, "--folder", str(folder))
        assert (done.returncode, "Two folders are named" in done.stderr) == (2, True), done.stderr


def test_without_any_recording_yet_what_was_named_is_what_is_missed(
    in_process: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    said = in_process("show", "20261128").stderr
    assert "There is no file 20261128, and no folder recordings to look for a cycle in." in said


@pytest.mark.parametrize("name", OF_ONE)
def test_a_name_with_a_slash_at_its_end_is_a_folder_s(in_process: Run, folder: Path, name: str) -> None:
    named = [f"{folder}/nowhere/", *(["good"] if name == "label" else [CYCLE] if name == "compare" else [])]
    done = in_process(name, *named)
    assert (done.returncode, f"There is no folder {folder}/nowhere/." in done.stderr) == (2, True), done.stderr
