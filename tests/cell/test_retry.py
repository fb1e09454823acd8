"""What follows a pick that failed: another grasp, another look, a hold - and never anything after a fault."""

from __future__ import annotations

import queue
from pathlib import Path

import numpy as np
import pytest

from bus.codes import Code
from bus.commands import CellState, CommandRequest, PresentRequest
from bus.frozen import Message
from bus.messages import Attempt, CycleResult
from bus.topics import Topic
from cell.build import running_cell
from cell.daemon.actions import Actions
from cell.daemon.retry import WITH_A_NEW_LOOK, WITH_ANOTHER_GRASP, Retries
from cell.machine.gate import Gate
from cell.machine.owner import refuse
from cell.pick.equipment import Equipment
from cell.pick.stages import FAULTS
from cell.replay.replay import Request, replay
from config.load import load_station
from config.pick import RetrySettings
from drivers.node.registry import open_devices
from logs.mcap.reader import read_cycle
from perception.models import open_models
from planning.robot import Robot

FIRST = Attempt(cycle_id="1", asked_by="http-page-1")
GRASP = np.eye(4)


def test_a_missed_grasp_is_left_out_of_the_next_try() -> None:
    retries = Retries(RetrySettings(grasps=1))
    second = retries.after(FIRST, Code.GRASP_MISSED, GRASP, "2")
    assert second is not None and (second.cycle_id, second.number, second.retry_of) == ("2", 1, "1")
    assert second.asked_by == FIRST.asked_by, "the same client asked for it"
    np.testing.assert_array_equal(second.missed, (GRASP,))
    assert retries.after(second, Code.GRASP_MISSED, GRASP, "3") is None


def test_another_failure_is_looked_at_again_with_every_grasp() -> None:
    retries = Retries(RetrySettings(looks=2))
    second = retries.after(FIRST, Code.DROPPED, GRASP, "2")
    assert second is not None and second.missed == ()
    assert retries.after(second, Code.NO_GRASP, None, "3") is not None
    assert retries.after(second, Code.NO_GRASP, None, "4") is None


@pytest.mark.parametrize(
    "code", [*sorted(FAULTS), Code.STOPPED, Code.NO_OBJECT, Code.SPEND_LIMIT, Code.MODEL_ACCESS, None]
)
def test_nothing_follows_a_fault_a_stop_an_empty_table_or_a_success(code: Code | None) -> None:
    assert code not in WITH_ANOTHER_GRASP | WITH_A_NEW_LOOK
    assert Retries(RetrySettings(grasps=9, looks=9)).after(FIRST, code, GRASP, "2") is None


def test_every_object_may_be_tried_as_often_as_the_first() -> None:
    retries = Retries(RetrySettings(looks=1))
    for cycle_id in ("2", "4"):
        assert retries.after(FIRST, Code.DROPPED, None, cycle_id) is not None
        assert retries.after(FIRST, Code.DROPPED, None, "3") is None


def test_a_hold_is_due_after_so_many_failures_in_a_row_and_then_the_count_begins_anew() -> None:
    retries = Retries(RetrySettings(grasps=0, looks=0, hold_after=2))
    said = []
    for code in (Code.DROPPED, None, Code.DROPPED, Code.NO_GRASP, Code.DROPPED):
        retries.after(FIRST, code, None, "2")
        said.append(bool(retries.holds()))
    assert said == [False, False, False, True, False]


@pytest.mark.thorough
def test_an_object_that_was_moved_away_under_the_hand_is_picked_where_it_is_now(tmp_path: Path) -> None:
    station = load_station(None, [f"recording.folder={tmp_path}", "retry.grasps=1", "verify.hold_s=0.5"])
    devices = open_devices("sim", station)
    camera, arm, hand, presenter = devices.camera, devices.arm, devices.hand, devices.presenter
    assert camera is not None and arm is not None and hand is not None and presenter is not None
    for device in (camera, arm, hand):
        device.connect()
    results: list[CycleResult] = []

    def meddle(stage: str) -> None:
        if stage == "execute" and not results:
            presenter.present(PresentRequest(object="cup", cycle=4, seed=0))

    equipment = Equipment(camera, arm, hand, Robot(station), station, open_models(station, {}))
    actions = Actions(
        equipment, Gate(), presenter, lambda: set(station.nodes), lambda *said: None, meddle, results.append
    )
    actions.reset()
    actions.restart_attempts(object_name="cup")
    for _ in range(2):
        actions.begin()
        actions.pick()
        actions.complete()
    camera.close()
    assert [(result.result, result.code) for result in results] == [("FAILED", "GRASP_MISSED"), ("SUCCESS", None)]
    assert (results[0].retried_as, results[1].retried_as) == (results[1].cycle_id, "")


def test_a_start_holds_after_too_many_failures_and_goes_on_when_somebody_has_looked(
    tmp_path: Path, endpoint: str
) -> None:
    said: queue.SimpleQueue[Message] = queue.SimpleQueue()
    settings = [
        "sim.friction=0",
        "verify.hold_s=0.3",
        "planning.max_approaches=6",
        "retry.looks=1",
        "retry.hold_after=1",
    ]
    station = load_station(None, [f"recording.folder={tmp_path}", f"bus.endpoint={endpoint}", *settings])

    def observe(_topic: Topic, message: Message | bytes) -> None:
        if isinstance(message, CellState | CycleResult):
            said.put(message)

    with running_cell(station, observe) as daemon:
        results: list[CycleResult] = []
        held = 0
        operator = CommandRequest(client_id="operator", cycles=1)
        refuse(daemon.command("reset", operator))
        while len(results) < 2 or held == 0:
            message = said.get(timeout=60)
            if isinstance(message, CycleResult):
                results.append(message)
            elif isinstance(message, CellState) and message.state == "Idle" and not results:
                refuse(daemon.command("start", operator))
            elif isinstance(message, CellState) and message.state == "Held":
                assert "A pick failed" in message.reason
                held += 1
                refuse(daemon.command("unhold", operator))
    assert results[0].code == "DROPPED" and [result.result for result in results] == ["FAILED", "FAILED"]
    assert [bool(result.retried_as) for result in results] == [True, False]
    second = Path(results[1].recording)
    assert read_cycle(second).attempt.retry_of == results[0].cycle_id
    assert replay(read_cycle(second), Request()).equal
