"""A month of cycles on a disk for a week of them: it is never full, no label is lost, and every cycle is told."""

from __future__ import annotations

import json
import random
from datetime import UTC, datetime, timedelta
from pathlib import Path

from config.load import load_station
from config.recording import RecordingSettings
from logs.catalogue import open_catalogue
from logs.catalogue.figures import summary
from logs.catalogue.journal import read_journal
from logs.catalogue.labels import Label, append
from logs.catalogue.store import CATALOGUE
from logs.mcap.names import found_below
from logs.mcap.recorder import Recorder
from logs.prune import Pruner

DAYS, CYCLES = 30, 6
DISK_BYTES, CYCLE_BYTES = 1_800_000, 30_000
STATION = load_station().model_dump_json().encode()


class Month:
    """A cell that records, a person who labels, and a disk of a size; the clock is the month's own.

    Attributes:
        told: what every cycle ended with. ``labelled``: those that a person has labelled.
    """

    def __init__(self, root: Path, **rule: float) -> None:
        self.root, self.now = root, datetime(2026, 6, 1, tzinfo=UTC)
        self.settings = RecordingSettings.model_validate({"folder": root, "min_free_mb": 0.05, **rule})
        self.told: dict[str, str] = {}
        self.labelled: set[str] = set()
        self.least_free = DISK_BYTES
        self._random = random.Random(7)

    def free(self, _folder: Path = Path()) -> int:
        return DISK_BYTES - sum(path.stat().st_size for path in found_below(self.root, "*.mcap"))

    def live(self) -> None:
        pruner = Pruner(self.settings, clock_ns=lambda: round(self.now.timestamp()) * 10**9, free=self.free)
        for number in range(DAYS * CYCLES):
            self._cycle(number)
            self.least_free = min(self.least_free, self.free())
            for one in pruner.plan().delete:
                assert pruner.do(one) is not None

    def _cycle(self, number: int) -> None:
        self.now += timedelta(days=1 / CYCLES)
        cycle_id = f"{self.now:%Y%m%dT%H%M%S}000"
        result = "FAILED" if self._random.random() < 0.1 else "SUCCESS"
        path = self.root / f"{self.now:%Y-%m-%d}" / f"{cycle_id}.mcap"
        recorder = Recorder(path, metadata={"cycle_id": cycle_id}, clock=lambda: 1)
        recorder.attach("station.json", "application/json", STATION)
        recorder.attach("noise", "application/octet-stream", self._random.randbytes(CYCLE_BYTES))
        recorder.close({"result": result, "code": "", "reason": f"number {number}"})
        self.told[cycle_id] = result
        if self._random.random() < 0.05:
            append(self.root, Label(cycle_id=cycle_id, at_ns=number, who="anna", label="good"))
            self.labelled.add(cycle_id)


def _rows(root: Path) -> list[tuple[object, ...]]:
    with open_catalogue(root) as catalogue:
        return list(catalogue.rows("SELECT * FROM cycles ORDER BY cycle_id"))


def test_a_month_on_a_small_disk(tmp_path: Path) -> None:
    month = Month(tmp_path, keep_free_gb=2e-4)
    month.live()
    left = {path.stem for path in found_below(tmp_path, "*.mcap")}
    assert month.labelled <= left, "nothing that a person labelled is lost"
    assert month.least_free > month.settings.min_free_mb * 1e6, "no cycle was refused"
    assert len(left) < len(month.told) / 2
    failed = {cycle_id for cycle_id, result in month.told.items() if result == "FAILED"}
    assert failed <= left, "successes go first, and they suffice"
    gone = {one.cycle_id for _, _, one in read_journal(tmp_path) if one is not None}
    assert gone == month.told.keys() - left
    _the_catalogue_is_right(month, left)


def _the_catalogue_is_right(month: Month, left: set[str]) -> None:
    rows = _rows(month.root)
    with open_catalogue(month.root) as catalogue:
        said = {
            one: (result, at) for one, result, at in catalogue.rows("SELECT cycle_id, result, deleted_ns FROM cycle")
        }
        assert {entry.cycle_id for entry in catalogue.entries()} == left, "what can be opened is listed"
    assert {one: result for one, (result, _) in said.items()} == month.told
    assert {one for one, (_, at) in said.items() if at is None} == left
    assert summary(month.root).total.cycles == len(month.told), "and all of them are counted"
    (month.root / CATALOGUE).unlink()
    assert _rows(month.root) == rows, "also when it is made anew"


def test_a_day_that_was_read_before_it_went_keeps_its_figures(tmp_path: Path) -> None:
    month = Month(tmp_path, keep_days=1.0)
    for number in range(3):
        month.now += timedelta(days=2)
        month._cycle(number)
    before = _rows(tmp_path)
    pruner = Pruner(month.settings, clock_ns=lambda: round(month.now.timestamp()) * 10**9)
    for one in pruner.plan().delete:
        pruner.do(one)
    with open_catalogue(tmp_path) as catalogue:
        columns = [name for _, name, *_ in catalogue.rows("PRAGMA table_info(cycles)")]
    kept = [place for place, name in enumerate(columns) if not name.startswith("deleted_")]
    assert [[row[n] for n in kept] for row in _rows(tmp_path)] == [[row[n] for n in kept] for row in before]
    assert not (tmp_path / "2026-06-03").exists()


def test_a_line_that_a_power_cut_tore_spoils_no_other(tmp_path: Path) -> None:
    month = Month(tmp_path, keep_days=1.0)
    for number in range(4):
        month.now += timedelta(days=2)
        month._cycle(number)
    pruner = Pruner(month.settings, clock_ns=lambda: round(month.now.timestamp()) * 10**9)
    first, *others = pruner.plan().delete
    pruner.do(first)
    with (tmp_path / "deleted.jsonl").open("a") as file:
        file.write(json.dumps({"file": "x"})[:5])
    assert len(_rows(tmp_path)) == 4
    for one in others:
        pruner.do(one)
    assert len(_rows(tmp_path)) == 4


def test_a_recording_that_comes_back_from_its_archive_is_there_again(tmp_path: Path) -> None:
    month = Month(tmp_path, keep_days=1.0)
    for number in range(2):
        month.now += timedelta(days=2)
        month._cycle(number)
    pruner = Pruner(month.settings, clock_ns=lambda: round(month.now.timestamp()) * 10**9)
    (due,) = pruner.plan().delete
    content = due.file.path.read_bytes()
    pruner.do(due)
    with open_catalogue(tmp_path) as catalogue:
        assert len(list(catalogue.entries())) == 1
    due.file.path.parent.mkdir()
    due.file.path.write_bytes(content)
    with open_catalogue(tmp_path) as catalogue:
        assert len(list(catalogue.entries())) == 2
