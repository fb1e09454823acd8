"""The recordings' folder is kept within its settings; what is not ours, not finished or pinned is left alone."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

from bus.errors import RecordingError
from config.schema import RecordingSettings
from logs.mcap.recorder import Recorder
from logs.mcap.retention import Plan, Recorded, Shelf, delete, in_words

NOW_NS = round(datetime(2026, 1, 9, tzinfo=UTC).timestamp()) * 10**9
BYTES = 1000


def _recorded(folder: Path, day: int, result: str = "SUCCESS", name: str = "") -> Path:
    cycle_id = f"2026010{day}T120000000"
    path = folder / f"2026-01-0{day}" / f"{name or cycle_id}.mcap"
    return Recorder(path, metadata={"cycle_id": cycle_id}, clock=lambda: 1).close({"result": result})


def _plan(folder: Path, **rule: float) -> Plan:
    return Shelf(folder).plan(NOW_NS, RecordingSettings(folder=folder, **rule))


def _deleted(folder: Path, **rule: float) -> list[str]:
    gone = list(delete(_plan(folder, **rule).delete))
    return [one.path.name for one in gone if isinstance(one, Recorded)]


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
    assert plan.delete == () and [file.path for file in plan.soon] == [soon]
    assert in_words(plan.soon).startswith("1 recordings (0.00 GB")


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
        assert shelf.plan(NOW_NS, RecordingSettings(folder=tmp_path, keep_gb=1000)) == ((), ())
        assert shelf.plan(NOW_NS, RecordingSettings(folder=tmp_path, keep_days=5)) == ((), ())
    assert len(read) == 2


def test_what_cannot_be_deleted_is_said_and_the_others_go(tmp_path: Path) -> None:
    kept, gone = (Recorded(tmp_path / name, BYTES, 1) for name in ("folder.mcap", "file.mcap"))
    kept.path.mkdir()
    gone.path.touch()
    first, second = delete([kept, gone])
    assert isinstance(first, RecordingError) and str(kept.path) in first.text
    assert second == gone and not gone.path.exists()


def test_a_folder_that_is_not_there_yet_holds_nothing(tmp_path: Path) -> None:
    assert _plan(tmp_path / "absent", keep_gb=1) == ((), ())


@pytest.mark.parametrize("name", ["20261399T120000000", "20260101T120000000.copy"])
def test_a_name_that_is_no_cycles_is_left_alone(tmp_path: Path, name: str) -> None:
    _recorded(tmp_path, 1, name=name)
    _recorded(tmp_path, 8)
    assert _deleted(tmp_path, keep_gb=1 / 1e9) == []
