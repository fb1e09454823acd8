"""More than one thing in the hand is no success: what tells of it, what does not, and what follows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest

from benchmarks.interfaces.multi_pick import Judged, provoked, single
from bus.codes import ADVICE, Code
from bus.messages import Attempt, CycleResult, Detections, Execution, PickPlan, Verdict
from cell.daemon.actions import Actions
from cell.daemon.retry import Retries
from cell.machine.gate import Gate
from cell.pick.equipment import Equipment
from cell.pick.several import may_be_several, one_thing
from cell.pick.verify import is_clear, verify
from cell.replay.replay import Request, replay
from config.load import load_station, station_from
from config.pick import RetrySettings
from config.schema import Station
from drivers.node.registry import open_devices
from logs.mcap.reader import read_cycle
from perception.models import open_models
from perception.scene.gone import Others
from planning.robot import Robot

RECORD = read_cycle(Path(__file__).parents[1] / "golden" / "cycle-schema4.mcap")
ResultT = TypeVar("ResultT")


def _recorded(kind: type[ResultT]) -> ResultT:
    return next(stage.result for stage in RECORD.stages.values() if isinstance(stage.result, kind))


FOUND, EXECUTION, SINGLE = _recorded(Detections), _recorded(Execution), _recorded(Verdict)
GRASP = FOUND.grasps[_recorded(PickPlan).grasp]


def _station(**need: float) -> Station:
    station = station_from(dict(RECORD.station))
    return station.model_copy(update={"verify": station.verify.model_copy(update=need)})


def _judged(station: Station, execution: Execution = EXECUTION, *, is_looked_at: bool = True) -> Verdict:
    after = RECORD.after if is_looked_at else None
    return verify(execution, FOUND, GRASP, RECORD.looks[0], after, Robot(station), station)


def test_a_load_above_what_one_object_weighs_is_that_of_several() -> None:
    verdict = _judged(_station(max_load_n=0.7 * SINGLE.load_n))
    assert (verdict.held, verdict.code, verdict.several_by) == (False, Code.MULTI_PICK, ("load",))
    assert "More than one thing" in verdict.reason and "weighs at most" in verdict.reason
    assert _judged(_station(max_load_n=1.5 * SINGLE.load_n)) == SINGLE


def test_it_replays_equal() -> None:
    station = _station(max_load_n=0.7 * SINGLE.load_n)
    said = RECORD.stages["verify"].model_copy(update={"result": _judged(station)})
    record = replace(RECORD, stages={**RECORD.stages, "verify": said}, station=station.model_dump(mode="json"))
    assert replay(record, Request(only="verify")).equal


def test_a_load_that_no_solid_thing_of_that_size_has_is_that_of_several() -> None:
    """Without a known weight only the density limits it: steel explains nearly everything."""
    assert _judged(_station(max_density_kg_m3=1.0, clear_load_n=0.0)).several_by == ("load",)
    assert _judged(_station(max_density_kg_m3=7850.0)) == SINGLE


def test_fingers_wider_apart_than_the_thing_is_long_hold_something_else_too() -> None:
    small = FOUND.scene.instances[0].model_copy(update={"size_m": np.full(3, 0.005), "number": GRASP.instance})
    scene = FOUND.scene.model_copy(update={"instances": (small,)})
    station = _station()
    found = FOUND.model_copy(update={"scene": scene})
    verdict = verify(EXECUTION, found, GRASP, RECORD.looks[0], None, Robot(station), station)
    assert (verdict.code, verdict.several_by) == (Code.MULTI_PICK, ("width",))


@pytest.mark.parametrize("was_between", [True, False])
def test_what_is_gone_was_taken_only_if_the_fingers_reached_it(
    was_between: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Elsewhere it rolled away; here, half of the one thing is named a second one, or what is far from it is."""
    labels = np.array(FOUND.scene.labels)
    is_one = labels == GRASP.instance
    columns = np.flatnonzero(is_one.any(axis=0))
    other = is_one & (np.arange(labels.shape[1]) >= columns.mean()) if was_between else np.zeros_like(is_one)
    other[:5, :5] |= not was_between
    found = FOUND.model_copy(update={"scene": FOUND.scene.model_copy(update={"labels": np.where(other, 9, labels)})})
    monkeypatch.setattr("cell.pick.several.others_gone", lambda *_: Others(gone=(3, 9), apart=(3, 9)))
    station = _station()
    verdict = verify(EXECUTION, found, GRASP, RECORD.looks[0], RECORD.after, Robot(station), station)
    assert verdict.also_gone == ((9,) if was_between else ()), verdict.reason
    assert verdict.held != was_between


def test_what_dropped_is_a_drop_however_much_it_was() -> None:
    assert EXECUTION.grasped is not None
    open_hand = EXECUTION.grasped.model_copy(update={"width_m": 0.0})
    runs = tuple(run.model_copy(update={"hand": open_hand}) if run.name == "hold" else run for run in EXECUTION.runs)
    dropped = EXECUTION.model_copy(update={"runs": runs})
    assert _judged(_station(max_load_n=0.0), dropped).code is Code.DROPPED


@pytest.mark.parametrize("settings", [{"max_load_n": 0.1}, {"clear_density_kg_m3": 1.0}])
def test_a_load_that_may_be_that_of_several_is_a_reason_to_look(settings: dict[str, float]) -> None:
    def asked(station: Station) -> bool:
        assert EXECUTION.grasped is not None
        one = lambda: one_thing(FOUND, GRASP, RECORD.looks[0])  # noqa: E731
        return not is_clear(GRASP, EXECUTION.grasped, EXECUTION.runs, Robot(station), station, one)

    assert asked(_station(**settings)) and not asked(_station())


def test_a_neighbour_between_the_opened_fingers_is_a_reason_to_look() -> None:
    one = one_thing(FOUND, GRASP, RECORD.looks[0])
    assert not may_be_several(one, SINGLE.load_n, _station())
    assert may_be_several(one._replace(has_neighbour=True), SINGLE.load_n, _station())


def test_it_is_not_tried_again_and_the_operator_is_told_what_to_do() -> None:
    assert Retries(RetrySettings(grasps=2, looks=2)).after(Attempt(cycle_id="1"), Code.MULTI_PICK, None, "2") is None
    assert "tray" in ADVICE[Code.MULTI_PICK]


# --- in simulation: the truth is what rose ---------------------------------------------------------------------------


def test_two_touching_blocks_in_one_grasp_are_noticed_with_and_without_the_look() -> None:
    two = _made(provoked("touching", 0))
    assert two.risen == 2
    assert {way: one.code for way, one in two.verdicts.items()} == dict.fromkeys(two.verdicts, Code.MULTI_PICK)
    assert two.verdicts["always"].several_by == ("place",) and two.verdicts["always"].also_gone
    assert {"place", "seam"} == set(two.verdicts["seam"].several_by)


def test_the_cell_lays_them_into_the_tray_reports_the_failure_and_does_not_try_again(tmp_path: Path) -> None:
    """A cup that is heavier than the settings allow one object to be."""
    options = [f"recording.folder={tmp_path}", "verify.hold_s=0.3", "verify.max_load_n=1.0", "retry.looks=1"]
    station, results = load_station(None, options), list[CycleResult]()
    devices = open_devices("sim", station)
    camera, arm, hand, presenter = devices.camera, devices.arm, devices.hand, devices.presenter
    assert camera is not None and arm is not None and hand is not None and presenter is not None
    for device in (camera, arm, hand):
        device.connect()
    equipment = Equipment(camera, arm, hand, Robot(station), station, open_models(station, {}))
    actions = Actions(
        equipment, Gate(), presenter, lambda: set(station.nodes), lambda *_: None, lambda _: None, results.append
    )
    actions.reset()
    actions.restart_attempts(object_name="cup")
    for act in (actions.begin, actions.pick, actions.complete):
        act()
    camera.close()
    (result,) = results
    assert (result.result, result.code, result.retried_as) == ("FAILED", Code.MULTI_PICK, "")
    assert result.advice == ADVICE[Code.MULTI_PICK] and result.laid is not None
    tray = station.scene.tray
    off_m = np.abs(presenter.truth().base_from_object[:2, 3] - tray.center_m[:2])
    assert (off_m < np.array(tray.size_m[:2]) / 2).all()


def test_one_of_two_touching_blocks_is_one() -> None:
    one = _made(single("beside", 2, None))
    assert one.risen == 1 and all(verdict.held for verdict in one.verdicts.values())


def _made(judged: Judged | None) -> Judged:
    assert judged is not None
    return judged


def test_a_limit_that_is_not_set_is_not_one() -> None:
    assert load_station(None, []).verify.max_load_n is None
    assert load_station(None, ["verify.max_load_n=2.5"]).verify.max_load_n == 2.5
