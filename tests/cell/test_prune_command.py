"""``cell prune`` as an operator uses it: first what would go, then it goes, and afterwards it is told."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from bus.errors import ConfigError, RecordingError
from cell.cli.commands import command_line
from logs.mcap.recorder import Recorder

OLD, FAILED, NEW = "20260101T080000000", "20260101T120000000", "20260102T080000000"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of three recordings, an old success, an old failure and the newest one."""
    for cycle_id, result in ((OLD, "SUCCESS"), (FAILED, "FAILED"), (NEW, "SUCCESS")):
        metadata = {"cycle_id": cycle_id}
        recorder = Recorder(_path(tmp_path, cycle_id), metadata=metadata, clock=lambda: 1)
        recorder.attach("station.json", "application/json", b"{}")
        recorder.close({"result": result})
    return tmp_path


def _path(folder: Path, cycle_id: str) -> Path:
    return folder / f"{cycle_id[:4]}-{cycle_id[4:6]}-{cycle_id[6:8]}" / f"{cycle_id}.mcap"


def _prune(folder: Path, *options: str, rule: str = "keep_days=30") -> Result:
    return CliRunner().invoke(command_line(), ["prune", str(folder), "--set", f"recording.{rule}", *options])


def test_a_dry_run_says_what_would_go_and_why_and_changes_nothing(folder: Path) -> None:
    before = sorted(folder.rglob("*"))
    said = _prune(folder, "--dry-run").stdout
    assert OLD in said and "recording.keep_days = 30" in said and "1 would be deleted" in said
    assert FAILED not in said and NEW not in said
    (line,) = _prune(folder, "--dry-run", "--json").stdout.splitlines()
    assert json.loads(line)["act"] == "deleted" and json.loads(line)["bytes"] > 0
    assert sorted(folder.rglob("*")) == before


def test_what_went_is_told_by_show_and_by_the_catalogue(folder: Path, tmp_path: Path) -> None:
    done = _prune(folder)
    assert (done.exit_code, done.stdout.splitlines()[0][:9]) == (0, "1 deleted")
    assert not _path(folder, OLD).exists() and _path(folder, FAILED).exists() and _path(folder, NEW).exists()
    sim = (Path(__file__).parents[2] / "config" / "sim.toml").read_text()
    station = tmp_path / "station.toml"
    station.write_text(f"{sim}\n[recording]\nfolder = '{folder}'\n")
    shown = CliRunner().invoke(command_line(), ["show", OLD, "--config", str(station)])
    assert isinstance(shown.exception, RecordingError)
    assert f"{OLD} was deleted on" in str(shown.exception) and "keep_days = 30" in str(shown.exception)
    query = ["query", "SELECT cycle_id FROM cycles WHERE deleted_ns > 0", "--csv", "--folder", str(folder)]
    assert CliRunner().invoke(command_line(), query).stdout.split() == ["cycle_id", OLD]


def test_what_is_trimmed_stays_and_is_not_replayed(folder: Path) -> None:
    done = _prune(folder, "--json", rule="thin_after_days=30")
    assert json.loads(done.stdout)["act"] == "trimmed"
    shown = CliRunner().invoke(command_line(), ["show", str(_path(folder, OLD))])
    assert "pictures    trimmed on" in shown.stdout
    replayed = CliRunner().invoke(command_line(), ["replay", str(_path(folder, OLD))])
    assert isinstance(replayed.exception, RecordingError) and replayed.exception.code == "TRIMMED"
    assert _prune(folder, rule="thin_after_days=30").stdout.startswith("0 deleted"), "only once"


def test_it_is_refused_while_a_cycle_is_recorded(folder: Path) -> None:
    open_one = _path(folder, "20260102T090000000")
    with Recorder(open_one, metadata={"cycle_id": open_one.stem}, clock=lambda: 1):
        done = _prune(folder)
        assert isinstance(done.exception, RecordingError) and "being recorded" in str(done.exception)
        assert _path(folder, OLD).exists() and _prune(folder, "--dry-run").exit_code == 0


def test_without_a_rule_nothing_goes_and_that_is_said(folder: Path) -> None:
    done = _prune(folder, rule="keep_days=0")
    assert "never deleted" in done.stderr and _path(folder, OLD).exists()


def test_an_archive_of_no_kind_or_among_the_recordings_is_refused_before_anything_goes(folder: Path) -> None:
    pytest.importorskip("fsspec", reason="vlad-cell[archive] is not installed")
    for address in ("nonsense://x", f"file://{folder}/nas"):
        done = _prune(folder, "--set", f"recording.archive={address}")
        assert isinstance(done.exception, ConfigError) and _path(folder, OLD).exists()


def test_what_goes_is_in_the_archive_whole(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    pytest.importorskip("fsspec", reason="vlad-cell[archive] is not installed")
    whole = _path(folder, OLD).read_bytes()
    nas = tmp_path_factory.mktemp("nas")
    archive = f"recording.archive=file://{nas}"
    assert "1 archived" in _prune(folder, "--set", archive, rule="thin_after_days=30").stdout
    done = json.loads(_prune(folder, "--set", archive, "--json").stdout)
    assert done["act"] == "deleted" and done["archived"] == f"file://{nas}/2026-01-01/{OLD}.mcap"
    assert Path(done["archived"].removeprefix("file://")).read_bytes() == whole, "not the trimmed one"
