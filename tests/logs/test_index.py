"""The list of recordings: newest first, and nothing hidden because it is damaged."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from bus.codes import Code
from bus.errors import RecordingError
from logs.catalogue.finding import find_recording
from logs.mcap.index import Filter
from logs.mcap.recorder import Recorder
from tests.logs.listed import listed

OLD = "20251231T120000000"
MORNING, NOON, EVENING = "20260101T080000000", "20260101T120000000", "20260101T200000000"


def _recorded(folder: Path, cycle_id: str, result: dict[str, str]) -> Path:
    path = folder / f"{cycle_id}.mcap"
    recorder = Recorder(path, metadata={"cycle_id": cycle_id}, clock=lambda: 1)
    recorder.attach("station.json", "application/json", b"{}")
    return recorder.close(result)


def _failed(folder: Path, cycle_id: str) -> Path:
    return _recorded(folder, cycle_id, {"result": "FAILED", "code": Code.NO_GRASP, "reason": "Too wide."})


def test_the_newest_comes_first_whatever_was_written_last(tmp_path: Path) -> None:
    for cycle_id in (NOON, EVENING, MORNING):
        _recorded(tmp_path, cycle_id, {"result": "SUCCESS"})
    assert [entry.cycle_id for entry in listed(tmp_path)] == [EVENING, NOON, MORNING]


def test_recordings_are_found_in_every_folder_below(tmp_path: Path) -> None:
    paths = [_recorded(tmp_path / day, cycle_id, {}) for day, cycle_id in (("b", MORNING), ("a", NOON))]
    assert [entry.path for entry in listed(tmp_path)] == paths[::-1]


def test_an_entry_tells_how_the_cycle_ended(tmp_path: Path) -> None:
    path = _failed(tmp_path, NOON)
    (entry,) = listed(tmp_path)
    said = {"recording": str(path), "cycle_id": NOON, "result": "FAILED", "code": "NO_GRASP", "reason": "Too wide."}
    assert said.items() <= entry.to_json().items()
    assert entry.failed


def test_an_entry_tells_its_object_its_time_and_which_try_it_was(record: Callable[..., Path], tmp_path: Path) -> None:
    record()
    (entry,) = listed(tmp_path)
    assert (entry.object, entry.wall_s, entry.number, entry.retried_as) == ("box", 2.0, 0, "")


def test_an_unfinished_recording_is_torn_even_where_a_whole_one_stands_beside_it(tmp_path: Path) -> None:
    _failed(tmp_path, MORNING)
    Recorder(tmp_path / f"{NOON}.mcap", metadata={"cycle_id": NOON}, clock=lambda: 1).abandon()
    torn, whole = listed(tmp_path)
    assert (torn.cycle_id, torn.result) == (NOON, "TORN") and "cell recover" in torn.reason
    assert (whole.cycle_id, whole.result) == (MORNING, "FAILED")


@pytest.mark.parametrize("keep", [0, 4, 100, -1, -40])
def test_a_damaged_recording_is_listed_with_its_reason(tmp_path: Path, keep: int) -> None:
    path = _failed(tmp_path, NOON)
    path.write_bytes(path.read_bytes()[:keep])
    (entry,) = listed(tmp_path)
    assert (entry.path, entry.cycle_id, entry.result) == (path, NOON, "DAMAGED")
    assert entry.reason and entry.failed


def test_a_folder_that_looks_like_a_recording_is_damaged(tmp_path: Path) -> None:
    (tmp_path / f"{NOON}.mcap").mkdir()
    (entry,) = listed(tmp_path)
    assert (entry.result, entry.reason) == ("DAMAGED", "cannot be read: Is a directory.")


def test_other_files_are_not_listed_and_an_empty_folder_lists_nothing(tmp_path: Path) -> None:
    (tmp_path / "report.html").write_text("<html>")
    (tmp_path / "notes.mcap.txt").write_text("not a recording")
    assert listed(tmp_path) == []


def test_a_missing_folder_is_said_to_be_missing(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"no folder .*absent"):
        listed(tmp_path / "absent")


@pytest.mark.parametrize(
    ("wanted", "ids"),
    [
        (Filter(failed=True), [EVENING, MORNING]),
        (Filter(code="no_grasp"), [MORNING]),
        (Filter(day="2026-01-01"), [EVENING, NOON, MORNING]),
        (Filter(day="2025"), [OLD]),
        (Filter(last=2), [EVENING, NOON]),
        (Filter(failed=True, last=1), [EVENING]),
    ],
)
def test_only_what_is_asked_for_is_listed(tmp_path: Path, wanted: Filter, ids: list[str]) -> None:
    _recorded(tmp_path, OLD, {"result": "SUCCESS"})
    _failed(tmp_path, MORNING)
    _recorded(tmp_path, NOON, {"result": "EMPTY", "code": Code.NO_OBJECT})
    _recorded(tmp_path, EVENING, {"result": "ABORTED", "code": Code.STOPPED})
    assert [entry.cycle_id for entry in listed(tmp_path, wanted)] == ids


def test_a_cycle_is_found_by_its_file_its_id_or_a_part_of_it(tmp_path: Path) -> None:
    noon = _failed(tmp_path / "day", NOON)
    _failed(tmp_path / "day", EVENING)
    for name in (str(noon), NOON, "T12", "1200"):
        assert find_recording(name, tmp_path) == noon
    with pytest.raises(RecordingError, match="2 cycles have '2026'"):
        find_recording("2026", tmp_path)
    with pytest.raises(RecordingError, match="no cycle 412"):
        find_recording("412", tmp_path)
