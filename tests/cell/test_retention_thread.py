"""Beside the cycles, on a thread of its own: what is deleted is said, and before that what will be."""

from __future__ import annotations

import threading
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

from bus import topics
from bus.messages import CycleResult
from cell.daemon.retention import Retention
from config.schema import RecordingSettings
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
            assert self._change.wait_for(lambda: len(self.events) >= count, 5)
        return [event[0] for event in self.events]


def _recorded(folder: Path, day: int) -> Path:
    path = folder / f"2026-01-0{day}" / f"2026010{day}T120000000.mcap"
    return Recorder(path, metadata={"cycle_id": "x"}, clock=lambda: 1).close({"result": "SUCCESS"})


def _retention(folder: Path, said: Said, **rule: float) -> Retention:
    return Retention(RecordingSettings(folder=folder, **rule), said, lambda: NOW_NS, period_s=0.0)


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


def test_a_folder_that_cannot_be_looked_into_is_an_event(tmp_path: Path) -> None:
    said = Said()
    _retention(tmp_path / ("n" * 300), said, keep_gb=1).tidy()
    assert said.events[0][:2] == ("RETENTION_FAILED", "warning")
