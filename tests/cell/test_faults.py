"""Every row of the fault table, on one running cell: the soak's first cycles walk through them. Who may set a fault."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmarks.growth import Growth
from benchmarks.soak import soak, soak_station, summary
from benchmarks.trials import Outcome, Trial, trials
from bus.errors import ConfigError, Refused
from bus.injection import PARTS, Fault
from cell import client
from cell.build import running_cell
from cell.cli.commands import command_line
from cell.daemon.fault_table import ROWS, Row
from cell.replay.replay import Request, replay
from config.load import load_station
from docs.faults_page import PAGE, page
from logs.mcap.reader import read_cycle

BY_NAME = {row.name: row for row in ROWS}


def test_every_part_has_a_row_for_every_word() -> None:
    assert set(BY_NAME) == {f"{part} {word}" for part in PARTS for word in Fault if word is not Fault.NONE} | {
        "node kill",
        "node freeze",
    }


def test_the_page_is_what_the_table_says() -> None:
    assert PAGE.read_text() == page(), "run `just docs`"


# --- one run over all of them -----------------------------------------------------------------------------------------


class Run:
    """The soak's first cycles: one for each row."""

    def __init__(self, folder: Path, endpoint: str) -> None:
        self.growth = Growth()
        station = soak_station(folder, endpoint, seed=1)
        series = soak(station, trials(ROWS, 1, 0), self.growth)
        self.outcomes = [outcome for _, outcome in zip(ROWS, series, strict=False)]
        series.close()  # type: ignore[attr-defined]

    def of(self, row: Row) -> Outcome:
        return next(one for one in self.outcomes if one.fault == row.name)


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory, new_endpoint: Callable[[], str]) -> Run:
    return Run(tmp_path_factory.mktemp("walk"), new_endpoint())


@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", BY_NAME)
def test_the_cell_does_what_the_table_says_and_is_ready_again(walk: Run, name: str) -> None:
    row = BY_NAME[name]
    outcome = walk.of(row)
    assert (outcome.result, outcome.code) == (row.result, str(row.code or "")), outcome.line()
    assert outcome.is_logged and outcome.is_idle, outcome.line()


def test_the_whole_run_is_explained_logged_and_never_stuck(walk: Run) -> None:
    figures = summary(walk.outcomes, walk.growth)
    assert figures["cycles"] == len(ROWS)
    assert (figures["unexplained"], figures["stuck_states"], figures["unlogged_cycles"]) == (0, 0, 0), figures["cases"]


@pytest.mark.parametrize("name", ["model off", "model garbage", "bus garbage"])
def test_a_recording_of_a_fault_replays(walk: Run, name: str) -> None:
    assert replay(read_cycle(Path(walk.of(BY_NAME[name]).recording)), Request()).equal


# --- who may set one --------------------------------------------------------------------------------------------------


def test_where_faults_are_not_allowed_nobody_listens(tmp_path: Path, endpoint: str) -> None:
    options = [f"bus.endpoint={endpoint}", f"recording.folder={tmp_path}"]
    station = load_station(None, options)
    with running_cell(station, lambda topic, message: None), client.connect(station) as cell:
        for part in ("arm", "disk"):  # one of the node's, one of the daemon's
            with pytest.raises(Refused, match=r"faults\.allowed") as refusal:
                cell.fault(part, Fault.OFF)
            assert refusal.value.exit_code == 3
        command = ["fault", "arm", "off", *(word for option in options for word in ("--set", option))]
        outcome = CliRunner().invoke(command_line(), command)
        assert isinstance(outcome.exception, Refused)
        assert CliRunner().invoke(command_line(), ["fault", "leg", "off"]).exit_code == 2


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
