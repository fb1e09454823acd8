"""The hand is watched from the grasp on, so that a short hold is enough; older recordings are judged as they were."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bus.codes import Code
from bus.messages import Detections, Execution, HandState, Motion, PickPlan, Verdict
from bus.trajectory import Trajectory
from cell.machine.gate import Gate
from cell.pick.execute import _hold, _Runner
from cell.pick.verify import verify
from config.load import load_station, station_from
from drivers.interface import Arm, Hand
from logs.mcap.reader import CycleRecord, read_cycle
from planning.robot import Robot

PICK = Path(__file__).parents[1] / "golden" / "cycle-schema4.mcap"


@pytest.fixture(scope="module")
def record() -> CycleRecord:
    return read_cycle(PICK)


def _executed(record: CycleRecord) -> Execution:
    execution = record.stages["execute"].result
    assert isinstance(execution, Execution)
    return execution


def _judged(record: CycleRecord, execution: Execution) -> Verdict:
    found, chosen = record.stages["detect"].result, record.stages["plan"].result
    assert isinstance(found, Detections) and isinstance(chosen, PickPlan) and record.after is not None
    station = station_from(dict(record.station))
    return verify(execution, found, found.grasps[chosen.grasp], record.looks[0], record.after, Robot(station), station)


def _watched(execution: Execution, *widths_m: float) -> Execution:
    """The same, recorded as today: with the hand's widths on the way."""
    assert execution.grasped is not None
    states = tuple(execution.grasped.model_copy(update={"width_m": width_m}) for width_m in widths_m)
    runs = tuple(
        run.model_copy(update={"hand_meanwhile": states}) if run.name == "carry" else run for run in execution.runs
    )
    return execution.model_copy(update={"runs": runs, "began": execution.grasped})


def test_an_older_recording_is_judged_as_it_was(record: CycleRecord) -> None:
    verdict = _judged(record, _executed(record))
    assert verdict == record.stages["verify"].result and verdict.carried_n is None


def test_what_is_carried_weighs_on_the_way_what_it_weighs_in_the_hold(record: CycleRecord) -> None:
    execution = _executed(record)
    assert execution.grasped is not None
    verdict = _judged(record, _watched(execution, execution.grasped.width_m))
    assert verdict.held and verdict.carried_n == pytest.approx(verdict.load_n, rel=0.15)


def test_a_width_that_falls_on_the_way_only_is_a_drop(record: CycleRecord) -> None:
    execution = _executed(record)
    assert execution.grasped is not None
    verdict = _judged(record, _watched(execution, execution.grasped.width_m, 0.0, execution.grasped.width_m))
    assert (verdict.held, verdict.code) == (False, Code.DROPPED)
    assert "width fell" in verdict.reason


def _at_the_end(execution: Execution, *widths_m: float, load_n: float | None = None) -> Execution:
    """The same with these widths in the hold, one after the other; of ``load_n`` 0 nothing weighs on the arm."""
    runs, left = [], list(widths_m)
    for run in execution.runs:
        if run.name == "hold":
            hand = run.hand.model_copy(update={"width_m": left.pop(0) if len(left) > 1 else left[0]})
            run = run.model_copy(update={"hand": hand})
        if load_n == 0:
            still = run.motion.model_copy(update={"tau_ext_nm": np.zeros_like(run.motion.tau_ext_nm)})
            run = run.model_copy(update={"motion": still})
        runs.append(run)
    return execution.model_copy(update={"runs": tuple(runs)})


def test_what_turned_flush_in_the_jaw_is_held_and_what_keeps_slipping_is_not(record: CycleRecord) -> None:
    execution = _executed(record)
    assert execution.grasped is not None
    wide_m = execution.grasped.width_m
    turned, slipping = (wide_m - 0.009, wide_m - 0.0092), (wide_m - 0.007, wide_m - 0.010)
    assert _judged(record, _at_the_end(execution, *turned)).held
    verdict = _judged(record, _at_the_end(execution, *slipping))
    assert (verdict.held, verdict.code) == (False, Code.DROPPED)
    light = _judged(record, _at_the_end(execution, *turned, load_n=0))
    assert (light.held, light.code) == (False, Code.DROPPED), "that it is still there, nothing says"


def test_what_is_too_light_to_weigh_is_held_when_its_place_is_empty(record: CycleRecord) -> None:
    execution = _executed(record)
    assert execution.grasped is not None
    light = _at_the_end(execution, execution.grasped.width_m, load_n=0)
    verdict = _judged(record, light)
    assert verdict.held and verdict.load_n == pytest.approx(0.0, abs=0.01)
    still_there = record.looks[0]
    verdict = _judged(replace(record, after=still_there), light)
    assert (verdict.held, verdict.code) == (False, Code.DROPPED)


class _StandsStill:
    """An arm and a hand of which only the motions they were asked for are of interest."""

    def __init__(self) -> None:
        self.lasted_s: list[float] = []

    def execute(self, trajectory: Trajectory) -> Motion:
        commands = trajectory.filtered()
        self.lasted_s.append(len(commands) * 1e-3)
        rest = np.zeros((1, 7))
        return Motion(
            finished=True, commanded_q_rad=commands, t_s=np.zeros(1), q_rad=rest, dq_rad_s=rest, tau_ext_nm=rest
        )

    def state(self) -> HandState:
        return HandState(stamp_ns=1, width_m=0.04, is_moving=False, is_homed=True)


@pytest.mark.parametrize(("hold_s", "pieces"), [(0.02, 1), (0.3, 3), (0.5, 5), (3.0, 10)])
def test_a_short_hold_is_read_in_fewer_pieces(record: CycleRecord, hold_s: float, pieces: int) -> None:
    station, both = load_station(None, [f"verify.hold_s={hold_s}"]), _StandsStill()
    plan = record.stages["plan"].result
    assert isinstance(plan, PickPlan)
    runner = _Runner(_as_arm(both), _as_hand(both), Gate(), station.hand)
    assert _hold(runner, plan, station)
    assert len(both.lasted_s) == pieces and sum(both.lasted_s) == pytest.approx(hold_s, abs=0.01)


def _as_arm(both: _StandsStill) -> Arm:
    return both  # type: ignore[return-value]


def _as_hand(both: _StandsStill) -> Hand:
    return both  # type: ignore[return-value]
