"""A bin emptied, as an operator and as another program does it; judged by MuJoCo's own truth."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from bus.commands import Presented
from bus.errors import Refused
from bus.messages import CycleResult
from bus.session import Bus
from cell import client
from cell.build import running_cell
from config.clock import clock_of
from config.load import DEFAULT_STATION, load_station
from config.schema import Station
from drivers.remote import RemotePresenter
from logs.mcap.reader import read_cycle

BIN_STATION = DEFAULT_STATION.with_name("bin.toml")
TWO_OBJECTS = ("sim.clutter=2", "sim.seed=1")
Run = Callable[..., subprocess.CompletedProcess[str]]


def _truth(station: Station) -> Presented:
    with Bus.join(station.cell_id, station.bus.endpoint) as bus, closing(RemotePresenter(bus, 5.0)) as presenter:
        presenter.connect()
        return presenter.truth()


def _lies_in(truth: Presented, station: Station) -> list[bool]:
    """Which objects lie over the tray's floor."""
    (x, y, _), (length, width, _) = station.scene.tray.center_m, station.scene.tray.size_m
    places = [one.base_from_object[:3, 3] for one in truth.objects]
    return [bool(abs(p[0] - x) < length / 2 and abs(p[1] - y) < width / 2 and p[2] > 0.0) for p in places]


# --- over the bus -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cell(
    tmp_path_factory: pytest.TempPathFactory, new_endpoint: Callable[[], str]
) -> Iterator[tuple[Station, client.Client]]:
    """A running cell with two objects in its bin, Stopped."""
    folder = tmp_path_factory.mktemp("recordings")
    options = [f"bus.endpoint={new_endpoint()}", f"recording.folder={folder}", "verify.hold_s=0.5", *TWO_OBJECTS]
    station = load_station(BIN_STATION, options)
    with running_cell(station, lambda topic, message: None), client.connect(station) as connection:
        yield station, connection


def _run_until_empty(connection: client.Client) -> list[str]:
    """Reset, ``start`` until empty, and the results of all its cycles."""
    connection.command("reset")
    connection.wait_for_state({"Idle"}, 60)
    cycle_id = connection.command("start", until_empty=True).cycle_id
    result = connection.wait_for_result(cycle_id, 60)
    results = {result.cycle_id: result}  # the message of the first may come after the answer
    while result.result not in ("EMPTY", "ABORTED"):
        said = connection.next_said(60)
        if isinstance(said, CycleResult):
            result = results[said.cycle_id] = said
    connection.wait_for_state({"Complete"}, 60)
    return [f"{result.result} {result.object}".strip() for result in results.values()]


def test_every_object_ends_in_the_tray_and_the_bin_is_empty(cell: tuple[Station, client.Client]) -> None:
    station, connection = cell
    before = _truth(station)
    assert _lies_in(before, station) == [False, False]
    results = _run_until_empty(connection)
    assert sorted(results) == sorted(["EMPTY", *(f"SUCCESS {one.name}" for one in before.objects)])
    assert results[-1] == "EMPTY"
    assert _lies_in(_truth(station), station) == [True, True]


def test_an_empty_bin_is_empty_at_once_and_no_cycle_refills_it(cell: tuple[Station, client.Client]) -> None:
    station, connection = cell
    clock = clock_of(station)
    started_s = clock.now_s()
    assert _run_until_empty(connection) == ["EMPTY"]
    assert clock.now_s() - started_s < 10


def test_an_object_by_name_is_refused_in_a_filled_bin(cell: tuple[Station, client.Client]) -> None:
    _, connection = cell
    connection.command("reset")
    connection.wait_for_state({"Idle"}, 60)
    with pytest.raises(Refused, match="'cup' cannot be presented") as refusal:
        connection.command("pick", object_name="cup")
    assert refusal.value.code == "TABLE_FILLED" and connection.state().state == "Idle"


# --- on the command line ----------------------------------------------------------------------------------------------


@pytest.fixture
def bin_options(options: list[str]) -> list[str]:
    return ["--config", str(BIN_STATION), "--until-empty", "--no-report", *options]


def _lines(done: subprocess.CompletedProcess[str]) -> list[dict[str, Any]]:
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_results_then_the_summary_and_exit_0_and_a_replay_is_equal(bin_options: list[str], in_process: Run) -> None:
    done = in_process("start", *bin_options, "--json", "--seed", "3", "--set", "sim.clutter=1")
    assert done.returncode == 0, done.stderr
    picked, empty, summary = _lines(done)
    assert (picked["result"], empty["result"]) == ("SUCCESS", "EMPTY") and picked["object"] and not empty["object"]
    assert summary == {
        "picked": 1,
        "failed": 0,
        "objects_left": 0,
        "is_empty": True,
        "reason": "Nothing rises above the table inside the pick region, of which 100% was seen.",
    }
    assert in_process("replay", picked["recording"]).returncode == 0, "it was placed where the recording says"


@pytest.mark.thorough
def test_the_place_where_a_thing_failed_for_good_is_kept_for_the_picks_that_follow(
    bin_options: list[str], in_process: Run
) -> None:
    """Fingers without friction hold nothing; a retry of the same pick still tries the same thing."""
    options = ["--set", "sim.clutter=2", "--set", "sim.friction=0", "--set", "retry.grasps=0", "--set", "retry.looks=1"]
    done = in_process("start", *bin_options, "--json", "--seed", "1", *options)
    *cycles, summary = _lines(done)
    assert done.returncode == 1 and summary["picked"] == 0
    records = [read_cycle(Path(one["recording"])) for one in cycles]
    failed_before = 0
    for record, cycle in zip(records, cycles, strict=True):
        assert len(record.attempt.failed_at) == failed_before
        failed_before += not cycle["retried_as"] and "execute" in record.stages
    assert failed_before >= 2
    tried_another = [
        cycle["recording"]
        for cycle, record in zip(cycles, records, strict=True)
        if record.attempt.failed_at and "execute" in record.stages
    ]
    assert in_process("replay", tried_another[0]).returncode == 0


def test_two_failures_that_touch_nothing_end_it_with_exit_1_and_the_last_reason(
    bin_options: list[str], in_process: Run
) -> None:
    """A hand that takes nothing narrower than its jaw finds no grasp, again and again."""
    options = ["sim.clutter=1", "hand.min_width_m=0.079", "retry.looks=0", "capture.views=1"]
    done = in_process("start", *bin_options, *(word for one in options for word in ("--set", one)))
    assert done.returncode == 1 and "Traceback" not in done.stderr
    last = done.stdout.splitlines()[-1]
    assert last.startswith("picked 0, failed 2, objects left: 1. 2 picks in a row failed, the last by NO_GRASP")


def test_a_number_of_cycles_and_until_empty_exclude_each_other(in_process: Run) -> None:
    done = in_process("start", "--until-empty", "--cycles", "3")
    assert done.returncode == 2 and "exclude each other" in done.stderr and "Traceback" not in done.stderr


@pytest.mark.thorough
def test_a_table_that_never_empties_is_refused(options: list[str], in_process: Run) -> None:
    done = in_process("start", "--until-empty", *options)
    assert done.returncode == 3 and "never empty" in done.stderr and "config/bin.toml" in done.stderr


def test_a_reach_into_a_wall_is_a_configuration_error(in_process: Run) -> None:
    region = "scene.pick_region_m=[0.2, 0.6, -0.2, 0.2]"
    done = in_process("start", "--config", str(BIN_STATION), "--until-empty", "--set", region)
    assert done.returncode == 2 and "bin-front" in done.stderr and "Traceback" not in done.stderr
