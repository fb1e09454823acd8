"""Whole picks of the simulated cell whose arm meets what it did not know of: it goes on there, or goes back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.contact import Pick, pick, place_post, post_under_palm, table_higher, with_post
from bus import topics
from bus.codec import encode
from bus.codes import ADVICE, Code
from bus.frozen import Message
from bus.messages import Attempt, CycleResult, PickPlan, StageRecord
from bus.sample import Sample
from bus.topics import Topic, encoding_of
from cell.cli.commands import command_line
from cell.daemon.actions import Actions
from cell.daemon.retry import Retries
from cell.machine.gate import Gate
from cell.pick.equipment import Equipment
from cell.pick.stages import FAULTS
from config.limits import check
from config.load import load_station
from config.pick import RetrySettings
from drivers.node.guard import Guard
from drivers.sim.arm import SimArm
from drivers.sim.camera import SimCamera
from drivers.sim.devices import SimPresenter
from drivers.sim.hand import SimHand
from drivers.sim.moved import move_box
from drivers.sim.world import World
from logs.mcap.reader import read_cycle
from logs.report.timeline import in_words
from perception.models import open_models
from planning.robot import Robot

GOLDEN = Path(__file__).parents[1] / "golden" / "cycle-schema4.mcap"


@pytest.fixture(scope="module")
def went_on() -> Pick:
    """A flat thing on a table that is 10 mm higher than when it was looked at."""
    return pick("spatula", table_higher(10.0))


@pytest.fixture(scope="module")
def went_back() -> Pick:
    """A post beside the thing, so high that the palm meets it before the fingers reach the thing."""
    return pick("controller", post_under_palm(9.8))


def test_on_a_higher_table_the_fingers_close_where_the_arm_met_it_and_hold(went_on: Pick) -> None:
    contact, verdict = went_on.execution.contact, went_on.verdict
    assert contact is not None and 0.004 < contact.remaining_m < contact.closes_within_m
    assert verdict.held and went_on.rose_m > 0.10
    assert went_on.felt.peak_n < 20.0 and went_on.felt.overshoot_mm < 3.0
    assert "the fingers closed there" in verdict.reason
    assert in_words(went_on.execution).startswith("The arm met ") and "closed at" in in_words(went_on.execution)


def test_where_they_would_not_reach_it_the_arm_goes_back_the_way_it_came(went_back: Pick) -> None:
    execution, verdict = went_back.execution, went_back.verdict
    assert (verdict.held, verdict.code, execution.grasped) == (False, Code.CONTACT, None)
    assert [run.name for run in execution.runs] == ["reach", "retreat"] and execution.stopped_in is None
    assert execution.contact is not None and execution.contact.remaining_m > execution.contact.closes_within_m
    down, up = (run.motion for run in execution.runs)
    np.testing.assert_allclose(up.commanded_q_rad[-1], down.commanded_q_rad[0], atol=1e-6)
    nearest_rad = [np.abs(down.commanded_q_rad - q).max(axis=1).min() for q in up.commanded_q_rad[::20]]
    assert max(nearest_rad) < 2e-3, "it leaves the way it came"
    assert in_words(execution).endswith("went back")
    assert went_back.rose_m < 0.005, "something was pushed"


def test_every_motion_keeps_the_limits(went_on: Pick, went_back: Pick) -> None:
    for run in (*went_on.execution.runs, *went_back.execution.runs):
        report = check(run.motion.commanded_q_rad)
        assert report.ok, f"{run.name}: {report.describe()}"


def test_a_contact_is_a_failed_pick_with_advice_and_the_next_grasp_is_tried() -> None:
    assert Code.CONTACT not in FAULTS and ADVICE[Code.CONTACT]
    again = Retries(RetrySettings(grasps=1)).after(Attempt(cycle_id="1"), Code.CONTACT, np.eye(4), "2")
    assert again is not None and len(again.missed) == 1


def test_recordings_of_before_were_not_felt() -> None:
    assert read_cycle(GOLDEN).station["execute"] == {"contact_n": 0.0, "beside_m": 0.0}


def test_after_a_contact_the_cell_looks_again_and_tries_another_grasp(tmp_path: Path) -> None:
    """Somebody puts a post there after the look, and takes it away again."""
    station = with_post(load_station(None, [f"recording.folder={tmp_path}", "retry.grasps=1", "verify.hold_s=0.5"]))
    world, robot, results = World(station), Robot(station), list[CycleResult]()
    plans, attempts = list[PickPlan](), list[Attempt]()
    camera, arm, hand = SimCamera(world), Guard(SimArm(world), station), SimHand(world)
    for device in (camera, arm, hand):
        device.connect()

    def hear(topic: Topic, said: Message | bytes) -> None:
        if isinstance(said, StageRecord) and isinstance(said.result, PickPlan):
            plans.append(said.result)
        if isinstance(said, Attempt):
            attempts.append(said)
        if topic in (topics.EXECUTE, topics.VERIFY) and isinstance(said, Message) and actions.log is not None:
            actions.log.hear(Sample(topic.key, encoding_of(type(said)), encode(said)))

    def meddle(stage: str) -> None:
        if stage == "execute":
            place_post(world, robot, plans[-1].segments[0].trajectory, -100.0 if results else 9.8)

    equipment = Equipment(camera, arm, hand, robot, station, open_models(station, {}))
    actions = Actions(equipment, Gate(), SimPresenter(world), lambda: set(station.nodes), hear, meddle, results.append)
    actions.reset()
    actions.restart_attempts(object_name="controller")
    for _ in range(2):
        actions.begin()
        actions.pick()
        move_box(world, "post", np.array([0.45, 0.0, -1.0]))
        actions.complete()
    camera.close()
    assert [(result.result, result.code) for result in results] == [("FAILED", Code.CONTACT), ("SUCCESS", None)]
    assert "before the grasp, too far" in results[0].reason and results[0].retried_as == results[1].cycle_id
    assert [len(attempt.missed) for attempt in attempts] == [0, 1]
    shown = CliRunner().invoke(command_line(), ["show", results[0].recording])
    assert "The arm met" in shown.stdout and "went back" in shown.stdout, shown.stdout
