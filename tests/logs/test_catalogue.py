"""The catalogue: derived from the recordings, made anew whenever it must be, read while it is written."""

from __future__ import annotations

import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from bus.commands import CellState
from bus.errors import RecordingError
from logs.catalogue import known_entries, open_catalogue
from logs.catalogue.columns import COLUMNS, NAMES, SCHEMA
from logs.catalogue.opening import open_store
from logs.catalogue.rows import file_of, row_of, values_of
from logs.catalogue.store import CATALOGUE
from logs.mcap.index import Filter, read_entry
from logs.mcap.reader import Timed, read_cycle, read_stages
from logs.mcap.recorder import Recorder
from tests.logs.listed import in_the_files

GOLDEN = sorted((Path(__file__).parents[1] / "golden").glob("*.mcap"))
Record = Callable[..., Path]
MORNING, NOON, EVENING = "20260101T080000000", "20260101T120000000", "20260101T200000000"
_WRITER = """
import sys
from pathlib import Path
from logs.catalogue.rows import File, row_of
from logs.catalogue.opening import open_store
root = Path(sys.argv[1])
store, (name, *rest) = open_store(root), row_of(root, File("", "a.mcap", 1, 1))
for number in range(100_000):
    store.put([(f"{number}.mcap", *rest)])
    print(number, flush=True)
"""


def _small(folder: Path, name: str, result: str = "SUCCESS", code: str = "", began: str = "") -> Path:
    folder.mkdir(exist_ok=True)
    metadata = {"cycle_id": name, **({"began": began} if began else {})}
    recorder = Recorder(folder / f"{name}.mcap", metadata=metadata, clock=lambda: 1)
    recorder.attach("station.json", "application/json", b"{}")
    return recorder.close({"result": result, "code": code, "reason": "So it ended."})


def _rows(folder: Path, *, thorough: bool = False) -> list[tuple[Any, ...]]:
    with open_catalogue(folder, thorough=thorough) as catalogue:
        return list(catalogue.rows(f"SELECT {', '.join(NAMES)} FROM cycles ORDER BY file"))


# --- rows -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("golden", GOLDEN, ids=lambda path: path.stem)
def test_every_golden_recording_gives_a_row_with_what_its_own_reader_says(golden: Path) -> None:
    row: dict[str, Any] = dict(zip(NAMES, row_of(golden.parent, file_of(golden, golden.parent)), strict=True))
    record = read_cycle(golden)
    assert row["unread"] is None and row == row | values_of(record), "the short reading says what the whole one does"
    assert (row["result"], row["looks"]) == (record.metadata["result"], len(record.looks))
    if row["result"] == "SUCCESS":
        assert row["held"] == row["executed"] == row["released"] == 1
        assert row["detect_s"] == record.stages["detect"].duration_s and 0 < row["width_m"] < row["opening_m"]


def test_a_row_holds_the_figures_of_every_stage_and_why_it_looked_again(record: Record, tmp_path: Path) -> None:
    path = record(None, again="The best grasp is weak.", found=True)
    row = dict(zip(NAMES, row_of(tmp_path, file_of(path, tmp_path)), strict=True))
    assert (row["looks"], row["looked_again"]) == (2, '["The best grasp is weak."]')
    assert (row["terms"], row["instances"], row["detect_s"]) == ('{"flat": 0.9, "patch": 0.5}', 1, 0.7)
    assert (row["model"], row["model_calls"], row["closed_m"], row["load_n"]) == ("geometric", 1, 0.03, 1.0)


def test_a_failed_plan_says_what_it_rejected_and_why(record: Record, tmp_path: Path) -> None:
    row = dict(zip(NAMES, row_of(tmp_path, file_of(record("plan"), tmp_path)), strict=True))
    assert (row["failed_stage"], row["rejected"], row["rejected_codes"]) == ("plan", 1, '{"COLLISION": 1}')
    assert row["held"] is None and row["executed"] == 0


def test_a_recording_that_cannot_be_read_has_a_row_with_the_reason(tmp_path: Path) -> None:
    path = _small(tmp_path, NOON)
    path.write_bytes(path.read_bytes()[:100])
    row = dict(zip(NAMES, row_of(tmp_path, file_of(path, tmp_path)), strict=True))
    assert (row["cycle_id"], row["result"], row["day"]) == (NOON, "DAMAGED", "2026-01-01") and row["unread"]


@pytest.mark.parametrize("seed", range(12))
def test_a_recording_with_a_few_other_bytes_has_a_row_all_the_same(tmp_path: Path, seed: int) -> None:
    rng, content = random.Random(seed), bytearray(GOLDEN[2].read_bytes())
    for _ in range(1 + seed):
        content[rng.randrange(len(content))] = rng.randrange(256)
    path = tmp_path / f"{NOON}.mcap"
    path.write_bytes(content)
    row = dict(zip(NAMES, row_of(tmp_path, file_of(path, tmp_path)), strict=True))
    assert row["result"] == read_entry(path).result and str(tmp_path) not in str(row["unread"])


def test_what_a_client_commanded_is_counted_and_what_the_cell_did_by_itself_is_not() -> None:
    said = (
        ("Execute", "", 1), ("Holding", "command 'hold' from anna", 2), ("Held", "", 3), ("Held", "", 4),
        ("Unholding", "command 'unhold' from anna", 5), ("Execute", "", 6), ("Holding", "the lease of anna is lost", 7),
        ("Stopping", "command 'stop' from cell", 8), ("Aborting", "command 'abort' from ben", 9),
    )  # fmt: skip
    states = tuple(
        Timed(at * 10**9, CellState(state=state, stage="", cycle_id="x", since_ns=0, available=(), reason=reason))
        for state, reason, at in said
    )
    values = values_of(replace(read_stages(GOLDEN[-1]), states=states))
    assert [values[name] for name in ("holds", "stops", "aborts", "paused_s")] == [1, 0, 1, 4.0]


def test_every_column_has_a_name_of_its_own_and_a_meaning() -> None:
    assert len(set(NAMES)) == len(NAMES) and all(column.meaning.endswith(".") for column in COLUMNS)


# --- up to date -------------------------------------------------------------------------------------------------------


def test_lists_say_what_the_files_say(record: Record, tmp_path: Path) -> None:
    record("plan", NOON)
    _small(tmp_path / "2026-01-01", MORNING)
    _small(tmp_path, EVENING).write_bytes(b"no recording")
    Recorder(tmp_path / f"{NOON[:-1]}1.mcap", metadata={"cycle_id": "x"}, clock=lambda: 1).abandon()
    for wanted in (Filter(), Filter(failed=True), Filter(code="no_grasp"), Filter(day="2026-01", last=2)):
        with open_catalogue(tmp_path) as catalogue:
            assert list(catalogue.entries(wanted)) == in_the_files(tmp_path, wanted)


def test_a_pick_that_waited_is_listed_by_when_it_began(tmp_path: Path) -> None:
    """It has the id of when it was asked for: of before the cycles that it waited for."""
    _small(tmp_path, MORNING, began=EVENING)
    _small(tmp_path, NOON, began=NOON)
    _small(tmp_path, f"{NOON[:-1]}1", began="no time")
    for most in (0, None):
        with open_catalogue(tmp_path, most=most) as catalogue:
            listed = list(catalogue.entries())
        assert [(one.cycle_id, one.began) for one in listed] == [
            (MORNING, EVENING),
            (f"{NOON[:-1]}1", ""),
            (NOON, NOON),
        ]
        assert listed == in_the_files(tmp_path)
        with open_catalogue(tmp_path, most=most) as catalogue:
            assert [one.cycle_id for one in catalogue.entries(Filter(last=1))] == [MORNING]


def test_a_list_that_may_not_wait_makes_no_row_and_says_the_same(tmp_path: Path) -> None:
    gone, changed = _small(tmp_path, MORNING), _small(tmp_path, NOON)
    _rows(tmp_path)
    gone.unlink()
    changed.write_bytes(b"no recording")
    _small(tmp_path / "2026-01-01", EVENING)
    for wanted in (Filter(), Filter(last=1), Filter(failed=True)):
        with open_catalogue(tmp_path, most=0) as catalogue:
            assert list(catalogue.entries(wanted)) == in_the_files(tmp_path, wanted) and catalogue.made == 0


def test_a_day_has_the_catalogue_of_its_recordings_folder(tmp_path: Path) -> None:
    day = tmp_path / "2026-01-01"
    path = _small(day, MORNING)
    _small(tmp_path / "2026-01-02", NOON)
    assert len(_rows(tmp_path)) == 2
    with open_catalogue(day) as catalogue:
        assert [entry.path for entry in catalogue.entries()] == [path]
    assert not (day / CATALOGUE).exists()


def test_only_what_is_new_or_has_changed_is_read_and_what_is_gone_has_no_row(tmp_path: Path) -> None:
    gone, changed, same = (_small(tmp_path, name) for name in (MORNING, NOON, EVENING))
    _rows(tmp_path)
    gone.unlink()
    changed.write_bytes(b"overwritten in place")
    with open_catalogue(tmp_path, thorough=True) as catalogue:
        assert catalogue.made == 1
        assert [(entry.path, entry.result) for entry in catalogue.entries()] == [
            (same, "SUCCESS"),
            (changed, "DAMAGED"),
        ]


def test_a_folder_that_has_not_changed_is_not_listed_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    day = tmp_path / "2026-01-01"
    path = _small(day, MORNING)
    monkeypatch.setattr("logs.catalogue.update._SETTLED_NS", -1)  # as some seconds later
    _rows(tmp_path)
    path.write_bytes(b"overwritten in place: the folder has the same time")
    assert {row[NAMES.index("result")] for row in _rows(tmp_path)} == {"SUCCESS"}
    assert {row[NAMES.index("result")] for row in _rows(tmp_path, thorough=True)} == {"DAMAGED"}
    shutil.rmtree(day)
    assert _rows(tmp_path) == []


def test_a_day_that_still_changes_keeps_its_rows_below_a_folder_that_does_not(tmp_path: Path) -> None:
    """As while a cell runs: its recordings folder is as it was for long, the day gets a report now and then."""
    day = _small(tmp_path / "2026-01-01", MORNING).parent
    os.utime(day, (1e9, 1e9))
    with open_catalogue(tmp_path):  # somebody has it open: the root gets no file, and no other time
        for _ in range(3):
            os.utime(tmp_path, (1e9, 1e9))
            assert [row[0] for row in _rows(tmp_path)] == [f"2026-01-01/{MORNING}.mcap"]
            os.utime(day)


def test_a_name_that_is_no_text_is_listed_and_has_no_row(tmp_path: Path) -> None:
    path = _small(tmp_path, NOON)
    strange = path.rename(os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9.mcap"))
    with open_catalogue(tmp_path) as catalogue:
        assert [entry.path for entry in catalogue.entries()] == [strange] and catalogue.made == 0


def test_entries_are_taken_from_the_catalogue_only_while_their_files_are_the_same(tmp_path: Path) -> None:
    same, changed = _small(tmp_path, MORNING), _small(tmp_path, NOON)
    _rows(tmp_path)
    changed.write_bytes(b"")
    read = known_entries(tmp_path)
    assert [read(path) for path in (same, changed)] == [read_entry(same), read_entry(changed)]
    assert known_entries(tmp_path / "nowhere")(same) == read_entry(same)


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="There is no folder"), open_catalogue(tmp_path / "nowhere"):
        pass


# --- lost, damaged, older ---------------------------------------------------------------------------------------------


@pytest.fixture
def whole(tmp_path: Path) -> Iterator[tuple[Path, list[tuple[Any, ...]]]]:
    """A folder of golden and small recordings, and the rows of its catalogue."""
    for path in GOLDEN[2:]:
        shutil.copy2(path, tmp_path / path.name)
    _small(tmp_path / "2026-01-01", NOON, "FAILED", "NO_GRASP")
    yield tmp_path, _rows(tmp_path)


def _clear(path: Path) -> None:
    for part in path.parent.glob(f"{path.name}*"):
        part.unlink()


def _overwrite(path: Path) -> None:
    path.write_bytes(b"this is no database" * 100)


def _tear(path: Path) -> None:
    with path.open("r+b") as file:
        file.seek(4096)
        file.write(b"\xff" * (path.stat().st_size - 4096))


def _age(path: Path) -> None:
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(f"PRAGMA user_version = {SCHEMA - 1}")


@pytest.mark.parametrize(
    ("spoil", "kept"), [(_clear, None), (_overwrite, "damaged"), (_tear, "damaged"), (_age, "older")]
)
def test_a_catalogue_that_is_lost_damaged_or_older_is_made_anew_row_by_row(
    whole: tuple[Path, list[tuple[Any, ...]]], spoil: Callable[[Path], None], kept: str | None
) -> None:
    folder, rows = whole
    said: list[str] = []
    spoil(folder / CATALOGUE)
    with open_catalogue(folder, tell=said.append, thorough=True) as catalogue:
        assert list(catalogue.rows(f"SELECT {', '.join(NAMES)} FROM cycles ORDER BY file")) == rows
    assert (folder / f"{CATALOGUE}.{kept}").exists() if kept else not said
    assert all(kept in text and "made anew" in text for text in said if kept) and len(said) == (kept is not None)


def test_where_it_cannot_be_written_it_is_made_in_memory_and_that_is_said(
    whole: tuple[Path, list[tuple[Any, ...]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, rows = whole
    said: list[str] = []
    (folder / ".catalogue.lock").unlink()
    (folder / ".catalogue.lock").mkdir()  # also for root, whom no rights keep out
    with open_catalogue(folder, tell=said.append) as catalogue:
        assert catalogue.made == 0, "the rows that are there are used"
        assert list(catalogue.rows(f"SELECT {', '.join(NAMES)} FROM cycles ORDER BY file")) == rows
    assert "not kept" in said[0]


# --- two processes ----------------------------------------------------------------------------------------------------


def test_a_killed_writer_loses_no_row_it_has_acknowledged_and_a_reader_reads_meanwhile(tmp_path: Path) -> None:
    with closing(open_store(tmp_path)) as store, subprocess.Popen(
        [sys.executable, "-P", "-c", _WRITER, str(tmp_path)],
        stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    ) as writer:  # fmt: skip
        assert writer.stdout is not None
        for acknowledged in writer.stdout:
            if int(acknowledged) in (5, 10, 15):
                (count,) = store.connection.execute("SELECT count(*) FROM cycles").fetchone()
                assert count > int(acknowledged), "what was acknowledged is read at once"
            if int(acknowledged) == 20:
                break
        writer.send_signal(signal.SIGKILL)
        last = max((int(line) for line in writer.stdout if line.endswith("\n")), default=20)
    with closing(open_store(tmp_path)) as store:
        (kept,) = store.connection.execute("SELECT count(*) FROM cycles").fetchone()
        assert kept >= last + 1
        assert store.connection.execute("PRAGMA quick_check").fetchone() == ("ok",)
