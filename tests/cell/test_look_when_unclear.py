"""With ``verify.look = "auto"`` the arm goes back for a look only when width and load leave the verdict open."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import pytest

from bus.codes import Code
from bus.messages import (
    ArmMode,
    ArmState,
    Detections,
    Execution,
    Grasp,
    HandState,
    Motion,
    Observation,
    PickPlan,
    Segment,
    Verdict,
)
from bus.trajectory import Trajectory
from cell.machine.gate import Gate
from cell.pick.execute import execute
from cell.pick.verify import is_clear, verify
from cell.replay.replay import Request, replay
from config.load import load_station
from config.schema import Station
from logs.mcap.reader import CycleRecord, read_cycle
from planning.robot import Robot

RECORD = read_cycle(Path(__file__).parents[1] / "golden" / "cycle-schema4.mcap")
LOOKED = ["reach", "carry", *["hold"] * 5, "aside", "return"]
UNLOOKED = LOOKED[:-2]


ResultT = TypeVar("ResultT")


def _result(kind: type[ResultT]) -> ResultT:
    return next(stage.result for stage in RECORD.stages.values() if isinstance(stage.result, kind))


RECORDED = _result(Execution)
FOUND = _result(Detections)
PLAN = _result(PickPlan)
GRASP = FOUND.grasps[PLAN.grasp]


def _with_ways_to_look(plan: PickPlan) -> PickPlan:
    place = plan.segments[2].trajectory.raw_q_rad
    ways = (("aside", place.copy()), ("return", place[::-1].copy()))
    more = (Segment.model_validate({"name": n, "route": "straight", "trajectory": Trajectory(raw_q_rad=q, window=64)})
            for n, q in ways)  # fmt: skip
    return plan.model_copy(update={"segments": (*plan.segments, *more)})


class Devices:
    """Arm and hand that repeat a recorded pick: the arm felt the recorded load, the fingers closed to ``width_m``.

    Attributes:
        stopped_in: the segment in which the arm stops for good.
        slips_in: the segment in which the fingers close further, ``slips_to_m``: they meet.
    """

    def __init__(self, plan: PickPlan, width_m: float) -> None:
        self._plan, self._held_m, self._width_m = plan, width_m, 0.08
        self._motions: dict[str, Motion] = {run.name: run.motion for run in RECORDED.runs}
        self._stamp_ns = 0
        self.gate = Gate()
        self.stopped_in = self.slips_in = ""
        self.slips_to_m = 0.0
        self.looks = 0

    # --- the arm ---

    def execute(self, trajectory: Trajectory) -> Motion:
        named = (part.name for part in self._plan.segments if part.trajectory.raw_q_rad is trajectory.raw_q_rad)
        name = next(named, "hold")
        self._width_m = self.slips_to_m if name == self.slips_in else self._width_m
        if name == self.stopped_in:
            self.gate.halt()
        recorded = self._motions.get(name, self._motions["carry"])
        return recorded.model_copy(update={"finished": name != self.stopped_in})

    def resume(self) -> None:
        pass

    def stop(self) -> None:
        pass

    # --- the hand ---

    def state(self) -> HandState | ArmState:
        self._stamp_ns += 1
        return HandState(stamp_ns=self._stamp_ns, width_m=self._width_m, is_moving=False, is_homed=True)

    def move(self, width_m: float, _speed_m_s: float) -> HandState | ArmState:
        self._width_m = width_m
        return self.state()

    def grasp(self, _force_n: float, _speed_m_s: float) -> HandState | ArmState:
        self._width_m = self._held_m
        return self.state()

    # --- the camera ---

    def look(self) -> Observation:
        self.looks += 1
        assert RECORD.after is not None
        return RECORD.after


class _Arm:
    """Its arm alone, since both have a state; at rest, so that nobody waits for it."""

    def __init__(self, devices: Devices) -> None:
        self.execute, self.resume, self.stop = devices.execute, devices.resume, devices.stop

    def state(self) -> ArmState:
        assert RECORD.observation is not None and RECORD.observation.view.arm is not None
        return RECORD.observation.view.arm.model_copy(update={"mode": ArmMode.IDLE})


STATION = load_station(None, ["verify.look=auto", "verify.hold_s=0.5"])
ROBOT = Robot(STATION)


def picked(devices: Devices, station: Station = STATION, grasp: Grasp = GRASP) -> tuple[Execution, Verdict | None]:
    arm, hand = _Arm(devices), devices
    execution, after = execute(
        devices._plan, grasp, (arm, hand), devices.look, ROBOT, station, devices.gate  # type: ignore[arg-type]
    )  # fmt: skip
    if execution.stopped_in is not None:
        return execution, None
    return execution, verify(execution, FOUND, grasp, RECORD.looks[0], after, ROBOT, station)


@pytest.fixture
def devices() -> Devices:
    return Devices(_with_ways_to_look(PLAN), GRASP.width_m - 0.002)


def names(execution: Execution) -> list[str]:
    return [run.name for run in execution.runs]


def test_what_is_clear_is_not_looked_at(devices: Devices) -> None:
    execution, verdict = picked(devices)
    assert names(execution) == UNLOOKED and devices.looks == 0 and execution.after is None
    assert verdict is not None and verdict.held and verdict.cleared_fraction is None
    assert "not looked at" in verdict.reason


def test_always_looks_from_where_it_holds(devices: Devices) -> None:
    devices._plan = PLAN
    execution, verdict = picked(devices)
    assert names(execution) == UNLOOKED and devices.looks == 1
    assert verdict is not None and verdict.held and verdict.cleared_fraction is not None


@pytest.mark.parametrize("more_mm", [-10.0, 10.0])
def test_fingers_that_stand_elsewhere_than_on_that_object_are_a_reason_to_look(more_mm: float) -> None:
    """Another object, or two of them."""
    devices = Devices(_with_ways_to_look(PLAN), GRASP.width_m + more_mm / 1e3)
    execution, verdict = picked(devices)
    assert names(execution) == LOOKED and devices.looks == 1 and execution.after is not None
    assert verdict is not None and verdict.held and verdict.cleared_fraction is not None


def test_an_object_that_turned_flush_in_the_jaw_is_a_reason_to_look(devices: Devices) -> None:
    """The fingers closed on it as planned, but no longer stand so: it may as well have slipped."""
    devices.slips_in, devices.slips_to_m = "carry", GRASP.width_m - 0.01
    execution, verdict = picked(devices)
    assert names(execution) == LOOKED and verdict is not None and verdict.held


def test_a_load_that_may_be_an_error_of_the_measurement_is_a_reason_to_look(devices: Devices) -> None:
    light = load_station(None, ["verify.look=auto", "verify.hold_s=0.5", "verify.clear_load_n=50"])
    assert names(picked(devices, light)[0]) == LOOKED


@pytest.mark.parametrize("share", [0.5, 1.6])
def test_another_load_on_the_way_than_in_the_hold_is_a_reason_to_look(devices: Devices, share: float) -> None:
    """Something hung on it, or has come along since."""
    empty_nm = devices._motions["reach"].tau_ext_nm[:10].mean(axis=0)
    carried = devices._motions["carry"]
    other_nm = empty_nm + share * (carried.tau_ext_nm - empty_nm)
    devices._motions["carry"] = carried.model_copy(update={"tau_ext_nm": other_nm})
    assert names(picked(devices)[0]) == LOOKED


def test_a_look_may_still_tell_that_the_object_lies_where_it_lay() -> None:
    devices = Devices(_with_ways_to_look(PLAN), GRASP.width_m + 0.01)
    demanding = load_station(None, ["verify.look=auto", "verify.hold_s=0.5", "verify.min_cleared_fraction=1.0"])
    before = RECORD.looks[0]
    devices.look = lambda: before  # type: ignore[method-assign]
    _, verdict = picked(devices, demanding)
    assert verdict is not None and (verdict.held, verdict.code) == (False, Code.NOT_CLEARED)


@pytest.mark.parametrize(("width_m", "code"), [(0.0, Code.GRASP_MISSED), (0.003, Code.GRASP_MISSED)])
def test_a_miss_is_clear(width_m: float, code: Code) -> None:
    execution, verdict = picked(Devices(_with_ways_to_look(PLAN), width_m))
    assert names(execution) == UNLOOKED and verdict is not None and (verdict.held, verdict.code) == (False, code)


@pytest.mark.parametrize("segment", ["carry", "hold"])
def test_a_drop_is_clear(devices: Devices, segment: str) -> None:
    devices.slips_in = segment
    execution, verdict = picked(devices)
    assert names(execution) == UNLOOKED and verdict is not None
    assert (verdict.held, verdict.code) == (False, Code.DROPPED)


@pytest.mark.parametrize("segment", ["aside", "return"])
def test_a_drop_on_the_way_to_the_look_and_back_is_a_drop(segment: str) -> None:
    devices = Devices(_with_ways_to_look(PLAN), GRASP.width_m + 0.01)
    devices.slips_in = segment
    execution, verdict = picked(devices)
    assert names(execution) == LOOKED and verdict is not None
    assert (verdict.held, verdict.code) == (False, Code.DROPPED)


@pytest.mark.parametrize("segment", ["reach", "carry", "hold", "aside", "return"])
def test_a_stop_ends_each_of_its_motions_and_nothing_moves_after(segment: str) -> None:
    devices = Devices(_with_ways_to_look(PLAN), GRASP.width_m + 0.01)
    devices.stopped_in = segment
    execution, verdict = picked(devices)
    assert execution.stopped_in == segment and verdict is None
    assert names(execution)[-1] == segment and names(execution) == LOOKED[: len(execution.runs)]


def test_a_recording_without_a_look_replays_equal(devices: Devices) -> None:
    execution, verdict = picked(devices)
    record = _recorded(execution, verdict)
    assert replay(record, Request(only="verify")).equal


def _recorded(execution: Execution, verdict: Verdict | None) -> CycleRecord:
    said = {"execute": execution, "verify": verdict}
    stages = {name: stage.model_copy(update={"result": said.get(name, stage.result)})
              for name, stage in RECORD.stages.items()}  # fmt: skip
    return replace(RECORD, stages=stages, after=None, station=STATION.model_dump(mode="json"))


def test_the_golden_pick_was_clear_by_the_numbers_that_it_measured() -> None:
    assert RECORDED.grasped is not None
    assert is_clear(GRASP, RECORDED.grasped, RECORDED.runs, ROBOT, STATION)
