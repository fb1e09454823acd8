"""Every row of the fault table, on running cells: the soak's first cycles walk through them."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from benchmarks.growth import Growth
from benchmarks.soak import soak, soak_station, summary
from benchmarks.trials import Outcome, Trial, trials
from bus.errors import ConfigError
from bus.fault_injection import PARTS, Fault
from cell.daemon.fault_table import DOORS, ROWS, Row
from cell.replay.replay import Request, replay
from config.load import load_station
from docs.faults_page import PAGE, page
from logs.mcap.reader import read_cycle

BY_NAME = {row.name: row for row in ROWS}


def test_every_part_has_a_row_for_every_word() -> None:
    assert set(BY_NAME) == {f"{part} {word}" for part in PARTS for word in Fault if word is not Fault.NONE} | {
        "node kill",
        "node freeze",
        *(f"{door} {word}" for door in DOORS for word in ("client", "kill", "freeze", "taken")),
    }


def test_the_page_is_what_the_table_says() -> None:
    assert PAGE.read_text() == page(), "run `just docs`"


# --- runs over all of them --------------------------------------------------------------------------------------------


def _slices() -> dict[str, tuple[Row, ...]]:
    """Return what runs on one cell: the first row of every part; and of each part the others."""
    first: dict[str, Row] = {}
    for row in ROWS:
        if row.part != "opcua":  # its door needs 7 s of computing to open
            first.setdefault(row.part, row)
    parts = dict.fromkeys(row.part for row in ROWS)
    others = {part: tuple(row for row in ROWS if row.part == part and row is not first.get(part)) for part in parts}
    return {"first": tuple(first.values()), **others}


SLICES = _slices()


def _marks(name: str) -> list[pytest.MarkDecorator]:
    """Each slice may run beside the others; the gate has the first."""
    group = pytest.mark.xdist_group(f"faults-{name}")
    return [group] if name == "first" else [group, pytest.mark.thorough]


def _rows(*names: str) -> list[Any]:
    """Parameters (slice, name of the row): of every row, or of those that are named."""
    return [
        pytest.param(slice_, row.name, marks=_marks(slice_), id=row.name)
        for slice_, rows in SLICES.items()
        for row in rows
        if row.name in names or not names
    ]


class Run:
    """The soak's first cycles: one for each row."""

    def __init__(self, rows: tuple[Row, ...], folder: Path, endpoint: str) -> None:
        self.rows, self.growth = rows, Growth()
        # a motion that lasts, where a frozen process is noticed by its silence
        pace = ("sim.pace=1",) if {row.part for row in rows} <= set(DOORS) else ()
        station = soak_station(folder, endpoint, seed=1, overrides=pace)
        series = soak(station, trials(rows, 1, 0), self.growth)
        self.outcomes = [outcome for _, outcome in zip(rows, series, strict=False)]
        series.close()  # type: ignore[attr-defined]

    def of(self, name: str) -> Outcome:
        return next(one for one in self.outcomes if one.fault == name)


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory, new_endpoint: Callable[[], str]) -> Callable[[str], Run]:
    """The run over a slice, made when it is first asked for."""
    return cache(lambda name: Run(SLICES[name], tmp_path_factory.mktemp("walk"), new_endpoint()))


def test_every_row_is_in_one_slice() -> None:
    assert sorted(row.name for rows in SLICES.values() for row in rows) == sorted(BY_NAME)


@pytest.mark.timeout(900)
@pytest.mark.parametrize(("slice_", "name"), _rows())
def test_the_cell_does_what_the_table_says_and_is_ready_again(
    walk: Callable[[str], Run], slice_: str, name: str
) -> None:
    row, outcome = BY_NAME[name], walk(slice_).of(name)
    assert (outcome.result, outcome.code) == (row.result, str(row.code or "")), outcome.line()
    assert outcome.is_logged and outcome.is_idle, outcome.line()
    assert outcome.was_held is row.holds, outcome.line()


@pytest.mark.parametrize("slice_", [pytest.param(name, marks=_marks(name)) for name in SLICES])
def test_the_whole_run_is_explained_logged_and_never_stuck(walk: Callable[[str], Run], slice_: str) -> None:
    run = walk(slice_)
    figures = summary(run.outcomes, run.growth)
    assert figures["cycles"] == len(run.rows)
    assert (figures["unexplained"], figures["stuck_states"], figures["unlogged_cycles"]) == (0, 0, 0), figures["cases"]


@pytest.mark.parametrize(("slice_", "name"), _rows("model off", "model garbage", "bus garbage"))
def test_a_recording_of_a_fault_replays(walk: Callable[[str], Run], slice_: str, name: str) -> None:
    assert replay(read_cycle(Path(walk(slice_).of(name).recording)), Request()).equal


# --- what a station may have ------------------------------------------------------------------------------------------


def test_a_station_cannot_have_a_fault_that_it_does_not_allow() -> None:
    with pytest.raises(ConfigError, match=r"faults\.allowed"):
        load_station(None, ["faults.arm=off"])
    assert load_station(None, ["faults.allowed=true", "faults.arm=off"]).faults.arm is Fault.OFF


def test_the_series_of_a_seed_is_always_the_same() -> None:
    def some(first: int) -> list[Trial]:
        return [trial for _, trial in zip(range(20), trials(ROWS, 7, first), strict=False)]

    assert some(40) == some(40)[:20]
    assert some(45)[:5] == some(40)[5:10]
    assert any(trial.row is None for trial in some(40))
