"""Beside the cycles, on a thread of its own: what is deleted is said, and before that what will be."""

from __future__ import annotations

import threading
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import pytest

from bus import topics
from bus.messages import Attempt, CycleResult
from cell.daemon.retention import Retention
from config.recording import RecordingSettings
from logs.catalogue.labels import Label, append
from logs.mcap.recorder import Recorder

NOW_NS = round(datetime(2026, 1, 9, tzinfo=UTC).timestamp()) * 10**9
RESULT = CycleResult(
    cycle_id="x", object="", result="SUCCESS", code=None, reason="", stages={}, wall_s=1.0, recording=""
)


class Said:
    """Events, waited for."""

    def __init__(self) -> None:
        self.events: list[tuple[str, ...]] = []
        self._change = threading.Condition()

    def __call__(self, *event: str) -> None:
        with self._change:
            self.events.append(event)
            self._change.notify()

    def wait_for(self, count: int) -> list[str]:
        with self._change:
            assert self._change.wait_for(lambda: len(self.events) >= count, 60)
        return [event[0] for event in self.events]


def _recorded(folder: Path, day: int) -> Path:
    path = folder / f"2026-01-0{day}" / f"2026010{day}T120000000.mcap"
    return Recorder(path, metadata={"cycle_id": "x"}, clock=lambda: 1).close({"result": "SUCCESS"})


def _retention(folder: Path, said: Said, **rule: float | str) -> Retention:
    settings = RecordingSettings.model_validate({"folder": folder, **rule})
    return Retention(settings, said, lambda: NOW_NS, period_s=0.0)


def test_it_deletes_at_the_start_and_says_what_is_next(tmp_path: Path) -> None:
    old, soon, new = (_recorded(tmp_path, day) for day in (1, 3, 8))
    said = Said()
    with closing(_retention(tmp_path, said, keep_days=6).start()):
        assert said.wait_for(2) == ["RETENTION", "RETENTION_AHEAD"]
    assert [path.exists() for path in (old, soon, new)] == [False, True, True]
    assert "1 recordings" in said.events[0][2] and "keep_days = 6" in said.events[0][2]
    assert ".keep" in said.events[1][3]


def test_it_looks_again_after_a_cycle_and_tells_the_observer(tmp_path: Path) -> None:
    said, heard = Said(), []
    retention = _retention(tmp_path, said, keep_days=2)
    hear = retention.after_cycles(lambda topic, _message: heard.append(topic))
    with closing(retention.start()):
        _recorded(tmp_path, 1)
        _recorded(tmp_path, 8)
        hear(topics.RESULT, RESULT)
        assert said.wait_for(1) == ["RETENTION"]
    assert heard == [topics.RESULT]


def test_without_a_rule_there_is_no_thread(tmp_path: Path) -> None:
    retention = _retention(tmp_path, Said()).start()
    assert not any(thread.name == "retention" for thread in threading.enumerate())
    retention.close()


def test_a_folder_that_cannot_be_looked_into_is_an_event_once_a_day(tmp_path: Path) -> None:
    said = Said()
    retention = _retention(tmp_path / ("n" * 300), said, keep_gb=1)
    retention.tidy()
    retention.tidy()
    assert [event[:2] for event in said.events] == [("RETENTION_FAILED", "warning")]


def test_nothing_goes_while_a_cycle_runs(tmp_path: Path) -> None:
    old, _ = _recorded(tmp_path, 1), _recorded(tmp_path, 8)
    said = Said()
    retention = _retention(tmp_path, said, keep_days=6)
    hear = retention.after_cycles(lambda _topic, _message: None)
    hear(topics.ATTEMPT, Attempt(cycle_id="x"))
    with closing(retention.start()):
        assert old.exists()
        hear(topics.RESULT, RESULT)
        assert said.wait_for(1) == ["RETENTION"]
    assert not old.exists()


def test_a_limit_that_labels_do_not_let_it_meet_is_said_once_a_day(tmp_path: Path) -> None:
    for day in (1, 8):
        _recorded(tmp_path, day)
    append(tmp_path, Label(cycle_id="20260101T120000000", at_ns=1, who="anna", label="good"))
    said = Said()
    retention = _retention(tmp_path, said, keep_gb=1e-9)
    retention.tidy()
    retention.tidy()
    assert [event[:2] for event in said.events] == [("RETENTION_SHORT", "warning")]


def test_without_its_archive_nothing_goes_and_one_event_says_why(tmp_path: Path) -> None:
    pytest.importorskip("fsspec", reason="vlad-cell[archive] is not installed")
    folder, blocked = tmp_path / "recordings", tmp_path / "blocked"
    blocked.touch()
    paths = [_recorded(folder, day) for day in (1, 2, 8)]
    said = Said()
    _retention(folder, said, keep_days=1, archive=f"file://{blocked}/cell").tidy()
    assert [event[:2] for event in said.events] == [("RETENTION_FAILED", "warning")]
    assert all(path.exists() for path in paths)
