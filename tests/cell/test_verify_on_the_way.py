"""The hand is watched from the grasp on, so that a short hold is enough; older recordings are judged as they were."""

from __future__ import annotations

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
