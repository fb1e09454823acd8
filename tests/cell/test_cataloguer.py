"""The daemon's own writer of the catalogue: a row a cycle, on a thread of its own; what goes wrong ends no cycle."""

from __future__ import annotations

import sqlite3
import threading
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from bus import topics
from bus.messages import CycleResult
from cell.daemon.cataloguer import Cataloguer
from logs.catalogue.rows import row_of
from logs.catalogue.store import CATALOGUE
from logs.mcap.recorder import Recorder

MORNING, NOON, EVENING = "20260101T080000000", "20260101T120000000", "20260101T200000000"


def _recorded(folder: Path, name: str) -> CycleResult:
    recorder = Recorder(folder / "2026-01-01" / f"{name}.mcap", metadata={"cycle_id": name}, clock=lambda: 1)
    recorder.attach("station.json", "application/json", b"{}")
    path = recorder.close({"result": "SUCCESS"})
    return CycleResult(cycle_id=name, object="", result="SUCCESS", code=None, reason="", stages={}, wall_s=1.0,
                       recording=str(path))  # fmt: skip


def _run(folder: Path, *results: CycleResult, has_older: bool = False) -> list[tuple[str, ...]]:
    """The events of a cataloguer that hears these results, after it has read the one older recording."""
    events: list[tuple[str, ...]] = []
    is_read = threading.Event()
    with closing(Cataloguer(folder, lambda *event: events.append(event), rest=is_read.set)) as cataloguer:
        hear = cataloguer.after_cycles(lambda *_: None)
        cataloguer.start()
        assert not has_older or is_read.wait(60)
        for result in results:
            hear(topics.RESULT, result)
    return events


def _rows(folder: Path) -> list[str]:
    with closing(sqlite3.connect(folder / CATALOGUE)) as connection:
        return [name for (name,) in connection.execute("SELECT cycle_id FROM cycles ORDER BY 1")]


def test_it_writes_what_it_does_not_know(tmp_path: Path) -> None:
    _recorded(tmp_path, MORNING)
    assert _run(tmp_path, has_older=True) == [] and _rows(tmp_path) == [MORNING]


def test_it_writes_every_cycle_that_closes_and_passes_on_what_it_hears(tmp_path: Path) -> None:
    heard = []
    with closing(Cataloguer(tmp_path, lambda *_: None)) as cataloguer:
        hear = cataloguer.after_cycles(lambda *said: heard.append(said))
        cataloguer.start()
        result = _recorded(tmp_path, NOON)
        hear(topics.RESULT, result)
        hear(topics.EVENT, b"")
    assert heard == [(topics.RESULT, result), (topics.EVENT, b"")] and _rows(tmp_path) == [NOON]


def test_the_first_cycle_of_a_new_folder_makes_the_catalogue(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    assert _run(folder) == [] and not folder.exists()
    assert _run(folder, _recorded(folder, NOON)) == []
    assert _rows(folder) == [NOON]


def test_a_catalogue_that_is_damaged_is_made_anew_and_that_is_said(tmp_path: Path) -> None:
    _recorded(tmp_path, MORNING)
    (tmp_path / CATALOGUE).write_bytes(b"this is no database" * 100)
    ((code, severity, text),) = _run(tmp_path, has_older=True)
    assert (code, severity) == ("CATALOGUE", "info") and "made anew" in text
    assert _rows(tmp_path) == [MORNING]


def test_one_that_is_deleted_under_its_hands_is_made_anew(tmp_path: Path) -> None:
    _recorded(tmp_path, MORNING)
    is_read, may_go_on = threading.Event(), threading.Event()

    def rest() -> None:
        is_read.set()
        assert may_go_on.wait(60)

    with closing(Cataloguer(tmp_path, lambda *_: None, rest)) as cataloguer:
        hear = cataloguer.after_cycles(lambda *_: None)
        cataloguer.start()
        assert is_read.wait(60)
        for part in tmp_path.glob(f"{CATALOGUE}*"):
            part.unlink()
        may_go_on.set()
        hear(topics.RESULT, _recorded(tmp_path, NOON))
    assert _rows(tmp_path) == [NOON], "whoever reads it next adds the older one"


def test_what_cannot_be_written_is_an_event_once_and_no_defect(tmp_path: Path) -> None:
    (tmp_path / ".catalogue.lock").mkdir()
    events = _run(tmp_path, *(_recorded(tmp_path, name) for name in (MORNING, NOON, EVENING)))
    assert [event[:2] for event in events] == [("CATALOGUE_FAILED", "warning")]
    assert "cell catalogue rebuild" in events[0][3]


def test_a_defect_of_the_catalogue_is_an_event_and_the_next_cycle_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    breaks = iter((True,))

    def row_once_broken(*given: Any) -> Any:
        return 1 / 0 if next(breaks, False) else row_of(*given)

    monkeypatch.setattr("cell.daemon.cataloguer.row_of", row_once_broken)
    events = _run(tmp_path, *(_recorded(tmp_path, name) for name in (MORNING, NOON)))
    assert [event[0] for event in events] == ["CATALOGUE_FAILED"] and "ZeroDivisionError" in events[0][2]
    assert NOON in _rows(tmp_path)


def test_a_recording_that_was_not_closed_has_no_row(tmp_path: Path) -> None:
    lost = _recorded(tmp_path, NOON)
    Path(lost.recording).unlink()
    assert _run(tmp_path, lost) == [] and _rows(tmp_path) == []
