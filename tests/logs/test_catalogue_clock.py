"""No recording is hidden, whatever the clock and the times of folders do: clocks are set, copies keep old times."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from logs.catalogue import open_catalogue
from logs.catalogue.figures import summed
from logs.catalogue.opening import open_store
from logs.catalogue.store import Stamp
from logs.catalogue.update import listing, update
from logs.mcap.index import Filter
from logs.mcap.recorder import Recorder
from tests.logs.listed import in_the_files

DAY = "2026-01-01"
TEN = datetime(2026, 1, 1, 10, tzinfo=UTC)
HOURS_NS = 3600 * 10**9


def _recorded(root: Path, name: str, day: str = DAY) -> Path:
    (root / day).mkdir(exist_ok=True)
    recorder = Recorder(root / day / f"{name}.mcap", metadata={"cycle_id": name}, clock=lambda: 1)
    recorder.attach("station.json", "application/json", b"{}")
    return recorder.close({"result": "SUCCESS", "code": "", "reason": ""})


@pytest.fixture(scope="module")
def example(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _recorded(tmp_path_factory.mktemp("example"), "20260101T080000000")


# --- what an operator saw ---------------------------------------------------------------------------------------------


def test_after_the_clock_was_set_back_what_is_recorded_now_is_the_newest(tmp_path: Path) -> None:
    for name in ("20260101T095000000", "20260101T103000000", "20260101T104000000", "20260101T095900000"):
        _recorded(tmp_path, name)  # the last one after the clock was set back by an hour
    wanted = Filter(last=2, now=TEN)
    with open_catalogue(tmp_path) as catalogue:
        listed = list(catalogue.entries(wanted))
    assert [entry.cycle_id for entry in listed] == ["20260101T095900000", "20260101T095000000"]
    with open_catalogue(tmp_path, most=0) as catalogue:
        assert list(catalogue.entries(wanted)) == listed == in_the_files(tmp_path, wanted)
        times = [entry.cycle_id[9:13] for entry in catalogue.entries(Filter(now=TEN))]
        assert times == ["0959", "0950", "1040", "1030"]


def test_the_page_counts_the_cycles_of_today_that_the_list_has(tmp_path: Path) -> None:
    """The page's figures come without a wait; a recording that has no row yet is read for them all the same."""
    for name in ("20260101T103000000", "20260101T095900000"):
        _recorded(tmp_path, name)
        for _ in range(2):
            with open_catalogue(tmp_path, most=32) as catalogue:
                entries = list(catalogue.entries(Filter(day="today", now=TEN)))
                assert summed(catalogue, DAY).total.cycles == len(entries) == len(list(tmp_path.rglob("*.mcap")))


def test_a_day_whose_time_is_still_to_come_keeps_its_rows_below_a_folder_that_does_not_change(tmp_path: Path) -> None:
    """The clock was an hour ahead, and is right again: the recordings folder is old, the day is of a time to come."""
    now_ns = os.stat(_recorded(tmp_path, "20260101T103000000").parent).st_ctime_ns
    os.utime(tmp_path / DAY, ns=(0, now_ns + HOURS_NS))
    with closing(open_store(tmp_path)) as store:
        for later_ns in (10**10, 2 * 10**10, 3 * 10**10):
            listed = listing(store, clock_ns=lambda later_ns=later_ns: now_ns + later_ns)  # type: ignore[misc]
            update(store, listed)
            assert not listed.gone and store.known(DAY)


def test_what_a_copy_adds_without_another_time_of_the_folder_is_found(tmp_path: Path, example: Path) -> None:
    """As of `rsync -a`: files come into a day, and the day gets its old time again."""
    day = _recorded(tmp_path, "20260101T080000000").parent
    os.utime(day, (1e9, 1e9))
    with closing(open_store(tmp_path)) as store:
        update(store, listing(store, clock_ns=lambda: 1 << 62))
        was_ns = os.stat(day).st_ctime_ns
        shutil.copy2(example, day / "20260101T090000000.mcap")
        os.utime(day, (1e9, 1e9))
        while os.stat(day).st_ctime_ns == was_ns:  # the disk's clock ticks some hundred times a second
            os.utime(day, (1e9, 1e9))
        assert [file.name for file in listing(store, clock_ns=lambda: 1 << 62).unknown] == ["20260101T090000000.mcap"]


def test_a_row_stays_while_its_file_is_there_whoever_says_that_it_is_gone(tmp_path: Path) -> None:
    path = _recorded(tmp_path, "20260101T080000000")
    with open_catalogue(tmp_path) as catalogue:
        catalogue.store.drop({DAY: [path.name]})
        assert list(catalogue.store.known(DAY)) == [path.name]


# --- in whatever order ------------------------------------------------------------------------------------------------

STEPS = st.lists(
    st.one_of(
        st.tuples(st.sampled_from(["add", "delete", "part"]), st.integers(0, 2), st.integers(0, 3)),
        st.tuples(st.just("stamp"), st.integers(-1, 2), st.sampled_from([0, 1, 1 << 61, 1 << 62])),
        st.tuples(st.just("clock"), st.just(0), st.sampled_from([0, 1, 1 << 61, 1 << 62])),
        st.tuples(st.sampled_from(["list", "update", "killed", "rename"]), st.integers(0, 2), st.just(0)),
    ),
    max_size=15,
)


@settings(max_examples=40)
@given(steps=STEPS)
def test_a_list_has_every_recording_on_the_disk_whatever_went_before(
    steps: list[tuple[str, int, int]], example: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Recordings come, go and are moved, folders get any time, the clock any, and readers are killed in between."""
    root = tmp_path_factory.mktemp("recordings")
    clock_ns, changes = 1 << 61, dict[Path, int]()
    with pytest.MonkeyPatch.context() as patch, closing(open_store(root)) as store:
        # The disk's own count of changes: no step of this test is slower than its clock.
        patch.setattr(
            "logs.catalogue.update._stamp", lambda path: Stamp(os.stat(path).st_mtime_ns, changes.get(path, 0))
        )
        for number, (what, which, value) in enumerate([*steps, ("update", 0, 0)]):
            day = root if which < 0 else root / f"2026-01-0{1 + which}"
            clock_ns = value if what == "clock" else clock_ns
            _change(what, day, value, example)
            if what in ("add", "part", "delete", "rename", "stamp"):
                changes[day], changes[root] = number, number if what in ("add", "part") else changes.get(root, 0)
            if what in ("list", "update", "killed"):
                listed = listing(store, clock_ns=lambda clock_ns=clock_ns: clock_ns)  # type: ignore[misc]
                rows = {(folder, name) for folder in store.folders_with_rows() for name in store.known(folder)}
                shown = rows - listed.pairs_gone() | {file[:2] for file in listed.unknown}
                assert shown == set(_on_disk(root, "*.mcap"))
                assert {file[:2] for file in listed.torn} == set(_on_disk(root, "*.part"))
                if what == "update":
                    update(store, listed)
                elif what == "killed" and listed.unknown:
                    with pytest.raises(KeyboardInterrupt):
                        update(store, listed, rest=_kill)


def _change(what: str, day: Path, value: int, example: Path) -> None:
    """One step."""
    file = day / f"20260101T08000000{value}.mcap"
    if what in ("add", "part"):
        day.mkdir(exist_ok=True)
        shutil.copy2(example, file if what == "add" else file.with_suffix(".mcap.part"))
    elif what == "delete":
        file.unlink(missing_ok=True)
    elif what == "rename" and day.is_dir():
        for part in day.glob("*.part"):
            part.rename(part.with_suffix(""))
    elif what == "stamp" and day.is_dir():
        os.utime(day, ns=(value, value))


def _kill() -> None:
    raise KeyboardInterrupt


def _on_disk(root: Path, pattern: str) -> Iterator[tuple[Any, ...]]:
    return ((path.parent.name, path.name) for path in root.rglob(pattern))
