"""Two cycles beside each other, and two folders: what differs, in which order, and how certain it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bus.messages import Execution
from logs.catalogue.columns import GROUPS
from logs.comparison.cycles import LATER, PLACES, compare_cycles
from logs.comparison.folders import Pick, compare_picks
from logs.comparison.intervals import median_difference, picks_needed, rate, rate_difference
from logs.mcap.reader import CycleRecord, read_cycle
from logs.report.comparison_pages import write_cycles_page, write_folders_page

Record = Callable[..., Path]


def _pick(n: int, **values: object) -> list[Pick]:
    usual = dict.fromkeys(Pick._fields) | {"object": "mug", "result": "SUCCESS", "code": "", "wall_s": 8.0}
    return [Pick(**{**usual, **values})] * n  # type: ignore[arg-type]


# --- intervals --------------------------------------------------------------------------------------------------------


def test_wilsons_interval_is_the_published_one() -> None:
    found = rate(15, 20)  # Newcombe 1998, and every table of it
    assert found is not None and found == pytest.approx((0.75, 0.5313, 0.8881), abs=1e-4)
    nothing, all_of_it = rate(0, 20), rate(20, 20)
    assert nothing is not None and all_of_it is not None
    assert (nothing.low, all_of_it.high) == (0.0, 1.0) and rate(0, 0) is None


def test_the_difference_of_rates_is_newcombes_method_10() -> None:
    found = rate_difference(rate(48, 80), rate(56, 70))  # his example: 56/70 against 48/80
    assert found == pytest.approx((0.2, 0.0524, 0.3339), abs=1e-4)


def test_most_intervals_of_equal_rates_hold_zero() -> None:
    rng = np.random.default_rng(1000)
    pairs = rng.binomial(60, 0.9, (2000, 2)).tolist()
    differences = [rate_difference(rate(one, 60), rate(other, 60)) for one, other in pairs]
    assert 0.93 < np.mean([not found.excludes_zero for found in differences if found is not None]) < 0.98


def test_a_difference_of_medians_is_the_same_at_every_call() -> None:
    found = median_difference([1.0, 1.1, 1.2, 0.9], [2.0, 2.1, 2.2, 1.9])
    assert found == median_difference([1.0, 1.1, 1.2, 0.9], [2.0, 2.1, 2.2, 1.9])
    assert found is not None and found.excludes_zero and median_difference([], [1.0]) is None
    assert picks_needed(0.9, 0.95) == 432 and picks_needed(0.9, 0.9) == 0


# --- folders ----------------------------------------------------------------------------------------------------------


def test_a_clear_improvement_is_better_and_a_small_trial_is_not_told_apart() -> None:
    failed = {"result": "FAILED", "code": "NO_GRASP"}
    before, after = _pick(60) + _pick(40, **failed), _pick(90) + _pick(10, **failed)
    assert compare_picks(before, after).answer.startswith("B is better: +30.0 points of success (+18")
    assert compare_picks(after, before).answer.startswith("B is worse")
    unclear = compare_picks(before[55:65], before[54:64]).answer
    assert unclear.startswith("Not to be told apart") and "picks a side" in unclear
    assert "nothing can be said" in compare_picks([], after).answer


def test_codes_and_objects_have_rows_of_their_own(tmp_path: Path) -> None:
    mugs, cups = _pick(9) + _pick(1, result="FAILED", code="DROPPED", executed=1, held=0), _pick(5, object="cup")
    found = compare_picks(mugs, mugs + cups)
    assert [(one.name, one.a, one.b) for one in found.codes] == [("DROPPED", (1, 10), (1, 15))]
    assert [(one.name, one.a, one.b) for one in found.objects] == [("mug", (9, 10), (9, 10)), ("cup", (0, 0), (5, 5))]
    assert found.held.a == (0, 1) and found.times[0].difference is not None
    page = write_folders_page(found, ("old <b>", "new"), tmp_path / "page.html").read_text()
    assert "DROPPED" in page and "old &lt;b&gt;" in page and "http" not in page


# --- cycles -----------------------------------------------------------------------------------------------------------


def _moved(record: CycleRecord) -> CycleRecord:
    """The same cycle, with another setting, and with the first motion apart after its fifth sample."""
    stage = record.stages["execute"]
    assert isinstance(stage.result, Execution)
    run, *others = stage.result.runs
    q_rad = run.motion.commanded_q_rad.copy()
    q_rad[5:, 1] += 0.25
    moved = run.model_copy(update={"motion": run.motion.model_copy(update={"commanded_q_rad": q_rad})})
    execution = stage.result.model_copy(update={"runs": (moved, *others)})
    station = {**record.station, "verify": {**record.station["verify"], "hold_s": 9.0}}
    stages = {**record.stages, "execute": stage.model_copy(update={"result": execution})}
    return replace(record, station=station, stages=stages)


def test_a_cycle_does_not_differ_from_itself(record: Record) -> None:
    cycle = read_cycle(record())
    found = compare_cycles(cycle, cycle, everything=True)
    assert not found.rows and found.first is None
    assert found.motion and all(row.apart_from_s is None and row.torque_nm == 0.0 for row in found.motion)


def test_where_a_cell_listens_and_records_is_no_input(record: Record) -> None:
    cycle = read_cycle(record())
    bus = {**cycle.station["bus"], "endpoint": "tcp/127.0.0.1:1"}
    elsewhere = replace(cycle, station={**cycle.station, "bus": bus, "recording": {"folder": "there"}})
    assert compare_cycles(cycle, elsewhere).first is None
    everything = compare_cycles(cycle, elsewhere, everything=True).first
    assert everything is not None and everything.name == "bus.endpoint"


def test_the_first_difference_is_the_input_and_the_motion_parts_at_its_time(record: Record) -> None:
    cycle = read_cycle(record())
    found = compare_cycles(cycle, _moved(cycle))
    assert found.first is not None
    assert (found.first.stage, found.first.kind, found.first.name) == ("asked", "input", "verify.hold_s")
    first = found.motion[0]
    assert (first.apart_from_s, first.joint) == (0.005, 2) and first.apart_rad == pytest.approx(0.25)
    assert "apart from 0.01 s on" in first.in_words() or "apart from 0.00 s on" in first.in_words()


def test_what_a_cycle_did_not_come_to_is_named_and_the_page_has_both(record: Record, tmp_path: Path) -> None:
    whole, failed = read_cycle(record()), read_cycle(record("plan", "20260101T000001000"))
    found = compare_cycles(whole, failed)
    assert {row.kind for row in found.rows} >= {"decision", "outcome"}
    assert [row.stage for row in found.rows] == sorted((row.stage for row in found.rows), key=_order)
    assert "only in A" in {row.in_words() for row in found.motion}
    page = write_cycles_page(found, tmp_path / "page.html").read_text()
    assert whole.cycle_id in page and failed.cycle_id in page and 'data-figure="chart-0"' in page


def _order(stage: str) -> int:
    return ("asked", "capture", "detect", "plan", "execute", "verify", "deliver", "result").index(stage)


def test_every_column_of_the_catalogue_has_its_place_in_a_comparison() -> None:
    groups = {group for group, _ in GROUPS}
    assert groups == {*PLACES, *LATER}
