"""The recordings' folder is kept within its settings; what is not ours, not finished or pinned is left alone."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

from bus.errors import RecordingError
from config.recording import RecordingSettings
from logs.catalogue import open_catalogue
from logs.catalogue.labels import Label, append
from logs.mcap.recorder import Recorder
from logs.mcap.retention import Due, Plan, Recorded, in_words
from logs.mcap.shelf import Shelf
from logs.prune import Done, Pruner, is_recording

NOW_NS = round(datetime(2026, 1, 9, tzinfo=UTC).timestamp()) * 10**9
BYTES = 1000


def _recorded(folder: Path, day: int, result: str = "SUCCESS", name: str = "") -> Path:
    cycle_id = f"2026010{day}T120000000"
    path = folder / f"2026-01-0{day}" / f"{name or cycle_id}.mcap"
    return Recorder(path, metadata={"cycle_id": cycle_id}, clock=lambda: 1).close({"result": result})


def _settings(folder: Path, **rule: float) -> RecordingSettings:
    return RecordingSettings.model_validate({"folder": folder, **rule})


def _plan(folder: Path, **rule: float) -> Plan:
    return Shelf(folder).plan(NOW_NS, _settings(folder, **rule))


def _deleted(folder: Path, **rule: float) -> list[str]:
    pruner = Pruner(_settings(folder, **rule), clock_ns=lambda: NOW_NS)
    gone = [pruner.do(one) for one in pruner.plan().delete]
    return [one.due.file.path.name for one in gone if isinstance(one, Done)]


def test_a_success_that_is_too_old_goes_with_its_page_and_its_empty_day(tmp_path: Path) -> None:
    old, failed, new = _recorded(tmp_path, 1), _recorded(tmp_path, 2, "FAILED"), _recorded(tmp_path, 8)
    for path in (old, failed, new):
        path.with_suffix(".html").write_text("page")
        path.with_name("index.html").write_text("day")
    assert _deleted(tmp_path, keep_days=5) == [old.name]
    assert not old.parent.exists()
    assert failed.exists() and failed.with_suffix(".html").exists() and new.exists()


def test_what_goes_within_a_day_is_known_before(tmp_path: Path) -> None:
    soon = _recorded(tmp_path, 3)
    _recorded(tmp_path, 8)
    plan = _plan(tmp_path, keep_days=6)
    assert plan.delete == () and [one.file.path for one in plan.soon] == [soon]
    assert in_words([one.file for one in plan.soon]).startswith("1 recordings (0.00 GB")


def test_beyond_its_room_the_oldest_success_goes_before_an_older_failure(tmp_path: Path) -> None:
    paths = [_recorded(tmp_path, 1, "FAILED"), _recorded(tmp_path, 2), _recorded(tmp_path, 3), _recorded(tmp_path, 4)]
    total = sum(path.stat().st_size for path in paths)
    assert _deleted(tmp_path, keep_gb=(total - 1) / 1e9) == [paths[1].name]
    assert _deleted(tmp_path, keep_gb=1 / 1e9) == [paths[2].name, paths[0].name], "the newest stays"


def test_only_what_the_cell_recorded_and_nobody_pinned_goes(tmp_path: Path) -> None:
    pinned, torn, mine, link, day = (_recorded(tmp_path, n) for n in (1, 2, 3, 4, 7))
    pinned.with_suffix(".keep").touch()
    torn.rename(torn.with_name(f"{torn.name}.part"))
    mine.rename(mine.with_name("experiment.mcap"))
    real = link.rename(tmp_path / "elsewhere")
    link.symlink_to(real)
    _recorded(tmp_path, 8)
    assert _deleted(tmp_path, keep_gb=1 / 1e9) == [day.name]
    left = {path.name for path in tmp_path.rglob("*.mcap*")}
    assert left == {pinned.name, f"{torn.name}.part", "experiment.mcap", link.name, "20260108T120000000.mcap"}


def test_a_recording_that_cannot_be_read_counts_as_a_failure(tmp_path: Path) -> None:
    damaged, fine = _recorded(tmp_path, 1), _recorded(tmp_path, 2)
    _recorded(tmp_path, 3)
    damaged.write_bytes(b"nothing")
    assert _deleted(tmp_path, keep_days=1) == [fine.name]


def test_a_recording_is_looked_into_once_and_only_where_it_may_go(tmp_path: Path) -> None:
    for day in (1, 2, 7, 8):
        _recorded(tmp_path, day, "FAILED")
    read: list[Path] = []

    def metadata(path: Path) -> dict[str, str]:
        read.append(path)
        return {"result": "FAILED"}

    shelf = Shelf(tmp_path, metadata)
    for _ in range(2):
        assert shelf.plan(NOW_NS, _settings(tmp_path, keep_gb=1000)) == Plan()
        assert shelf.plan(NOW_NS, _settings(tmp_path, keep_days=5)) == Plan()
    assert len(read) == 2


def test_what_cannot_be_deleted_is_said_and_written_down_only_once_it_goes(tmp_path: Path) -> None:
    path = _recorded(tmp_path, 1)
    path.with_suffix(".html").mkdir()
    with pytest.raises(RecordingError, match="cannot be deleted"):
        Pruner(_settings(tmp_path, keep_days=1)).do(Due(Recorded(path, BYTES, 1), "delete", "recording.keep_days = 1"))
    assert path.exists()
    with open_catalogue(tmp_path) as catalogue:
        assert [entry.path for entry in catalogue.entries()] == [path]


def test_what_a_person_labelled_stays_also_when_that_was_after_the_plan(tmp_path: Path) -> None:
    first, second = _recorded(tmp_path, 1), _recorded(tmp_path, 2)
    _recorded(tmp_path, 8)
    append(tmp_path, Label(cycle_id=first.stem, at_ns=1, who="anna", note="look at this"))
    pruner = Pruner(_settings(tmp_path, keep_gb=1e-9))
    (due,) = pruner.plan().delete
    append(tmp_path, Label(cycle_id=second.stem, at_ns=2, who="anna", label="bad"))
    assert pruner.do(due) is None
    assert first.exists() and second.exists()
    assert _deleted(tmp_path, keep_gb=1e-9, keep_labelled=False) == [first.name, second.name]


def test_a_failure_that_is_too_old_goes_by_its_own_setting(tmp_path: Path) -> None:
    failed, fine = _recorded(tmp_path, 1, "FAILED"), _recorded(tmp_path, 2)
    _recorded(tmp_path, 8)
    assert _deleted(tmp_path, keep_failed_days=5) == [failed.name]
    assert fine.exists()


def test_two_do_not_prune_one_folder(tmp_path: Path) -> None:
    _recorded(tmp_path, 1)
    first, second = (Pruner(_settings(tmp_path, keep_days=1)) for _ in range(2))
    with first.alone() as is_alone, second.alone() as is_alone_too:
        assert (is_alone, is_alone_too) == (True, False)


def test_a_cycle_is_recorded_while_its_file_grows(tmp_path: Path) -> None:
    path = tmp_path / "2026-01-08" / "20260108T120000000.mcap"
    recorder = Recorder(path, metadata={"cycle_id": path.stem}, clock=lambda: 1)
    assert is_recording(tmp_path)
    recorder.close({"result": "SUCCESS"})
    assert not is_recording(tmp_path)


def test_free_space_that_refuses_cycles_before_anything_goes_is_refused() -> None:
    with pytest.raises(ValueError, match="min_free_mb"):
        RecordingSettings(keep_free_gb=0.4, min_free_mb=500.0)


def test_an_archive_with_a_password_is_refused_without_showing_it() -> None:
    with pytest.raises(ValueError, match="environment"):
        RecordingSettings(archive="ftp://anna:secret@nas/cell")


def test_a_folder_that_is_not_there_yet_holds_nothing(tmp_path: Path) -> None:
    assert _plan(tmp_path / "absent", keep_gb=1) == Plan()


@pytest.mark.parametrize("name", ["20261399T120000000", "20260101T120000000.copy"])
def test_a_name_that_is_no_cycles_is_left_alone(tmp_path: Path, name: str) -> None:
    _recorded(tmp_path, 1, name=name)
    _recorded(tmp_path, 8)
    assert _deleted(tmp_path, keep_gb=1 / 1e9) == []
