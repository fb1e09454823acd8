"""The arm looks again from other places when it is worth it: why, how often, what is recorded, and how it ends."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus import topics
from bus.codec import encode
from bus.codes import Code
from bus.errors import ArmReflex, CycleFailure
from bus.frozen import Message
from bus.messages import (
    ArmMode,
    CycleResult,
    Detections,
    Failure,
    Frame,
    Grasp,
    Motion,
    PickPlan,
)
from bus.sample import Sample
from bus.sensor_codec import frame_from_wire, frame_to_wire
from bus.topics import Topic, encoding_of
from bus.trajectory import Trajectory
from cell.daemon.actions import Actions
from cell.machine.gate import Gate
from cell.pick.equipment import Equipment
from cell.pick.looking import asked_for, why_look_again
from cell.pick.stages import FAULTS
from cell.replay.replay import Request, replay
from config.load import load_station
from drivers.interface import Arm, Camera, Devices
from drivers.node.registry import open_devices
from drivers.sim.world import World
from logs.mcap.reader import CycleRecord, read_cycle
from perception.models import open_models
from planning.robot import Robot

_OBJECT = (
    '<mujoco><worldbody><body><geom type="{}" size="{}" pos="0 0 {}" mass="0.3" rgba="0.8 0.5 0.2 1"/>'
    "</body></worldbody></mujoco>"
)
_OBJECTS = {"tall": ("cylinder", "0.03 0.1", 0.1), "low": ("box", "0.04 0.02 0.025", 0.025)}
"""Kind, half its size, and height of its middle [m]. The tall one's top is nearer to the camera than its least range.
"""
_IN_VAIN = "scene.table={name='table', center_m=[0.45, 0, -0.02], size_m=[0.9, 1.4, 0.04], tolerance_mm=0.1}"
"""No table lies so exactly where it should, however often it is looked at."""
_TWO_IN_VAIN = (_IN_VAIN, "capture.most_views=2")
CAPTURE = np.array(load_station().arm.capture_q_rad)


class WatchedArm:
    """An arm that counts its motions, and has a reflex in one of them."""

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self.motions, self.reflex_in = 0, 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._arm, name)

    def execute(self, trajectory: Trajectory) -> Motion:
        self.motions += 1
        if self.motions == self.reflex_in:
            raise ArmReflex("The arm touched something.")
        return self._arm.execute(trajectory)


class RecordedCamera:
    """A camera whose frames travel as on the bus: they are recorded, and used as they come back from there."""

    def __init__(self, camera: Camera, hear: Callable[[Topic, bytes], None]) -> None:
        self._camera, self._hear = camera, hear

    def capture(self) -> Frame:
        wire = frame_to_wire(self._camera.capture())
        for topic in topics.FRAME_PARTS:
            self._hear(topic, wire[topic.key])
        return frame_from_wire(wire)


class Bench:
    """Whole cycles with simulated devices, each recorded; ``tick`` is called with every command to the arm."""

    def __init__(self, devices: Devices, settings: list[str]) -> None:
        self._devices, self._settings = devices, settings
        self.robot = Robot(load_station(None, settings))
        assert devices.arm is not None
        self.arm = WatchedArm(devices.arm)
        self.stages: list[str] = []
        self.gate = Gate()
        self.tick: Callable[[], None] = lambda: None

    def actions(self, *overrides: str) -> Actions:
        """The actions of a cell with these settings, its arm at the capture pose after no motion."""
        station = load_station(None, [*self._settings, *overrides])
        self.stages, self.gate, self.results, self.tick = [], Gate(), list[CycleResult](), lambda: None
        assert self._devices.camera is not None and self._devices.hand is not None

        def hear(topic: Topic, message: Message | bytes) -> None:
            payload = message if isinstance(message, bytes) else encode(message)
            if actions.log is not None:
                actions.log.hear(Sample(topic.key, encoding_of(topic.says), payload))

        camera = RecordedCamera(self._devices.camera, hear)
        equipment = Equipment(
            camera,  # type: ignore[arg-type]  # only `capture` is used
            self.arm,
            self._devices.hand,
            self.robot,
            station,
            open_models(station, {}),
        )
        presenter = self._devices.presenter
        actions = Actions(
            equipment, self.gate, presenter, lambda: set(station.nodes), hear, self.stages.append, self.results.append
        )
        actions.reset()
        self.arm.motions = self.arm.reflex_in = 0
        return actions

    def pick(self, name: str, *overrides: str) -> CycleRecord:
        """The recording of one whole cycle."""
        actions = self.actions(*overrides)
        actions.restart_attempts(object_name=name)
        actions.begin()
        actions.pick()
        actions.complete()
        return self.recording

    def stopped(self, actions: Actions, name: str) -> CycleRecord:
        """The recording of a cycle that is stopped, or that a fault ends."""
        actions.restart_attempts(object_name=name)
        actions.begin()
        with pytest.raises(CycleFailure):
            actions.pick()
        actions.stop(lambda wait_s: True)
        return self.recording

    @property
    def recording(self) -> CycleRecord:
        (result,) = self.results
        return read_cycle(Path(result.recording))


@pytest.fixture(scope="module")
def devices_and_settings(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Devices, list[str]]]:
    folder = tmp_path_factory.mktemp("looking")
    for name, shape in _OBJECTS.items():
        (folder / "objects" / name).mkdir(parents=True)
        (folder / "objects" / name / "object.xml").write_text(_OBJECT.format(*shape))
    settings = [f"sim.objects={folder / 'objects'}", f"recording.folder={folder}", "verify.hold_s=0.2"]
    devices = open_devices("sim", load_station(None, settings))
    for device in (devices.camera, devices.arm, devices.hand):
        assert device is not None
        device.connect()
    yield devices, settings
    assert devices.camera is not None
    devices.camera.close()


@pytest.fixture
def bench(devices_and_settings: tuple[Devices, list[str]], monkeypatch: pytest.MonkeyPatch) -> Bench:
    bench, command_arm = Bench(*devices_and_settings), World.command_arm

    def watched(world: World, q_rad: np.ndarray, last_q_rad: np.ndarray) -> None:
        command_arm(world, q_rad, last_q_rad)
        bench.tick()

    monkeypatch.setattr(World, "command_arm", watched)
    return bench


def _at_capture_pose(bench: Bench) -> bool:
    """Nearly: a simulated arm still creeps towards its last command when its motion is over."""
    return bool(np.abs(bench.arm.state().q_rad - CAPTURE).max() < 2e-3)


# --- why --------------------------------------------------------------------------------------------------------------


def _grasps(score: float) -> Detections:
    """A detection whose best grasp has this score; nothing else of it is asked for."""
    best = Grasp(base_from_tcp=np.eye(4), width_m=0.04, opening_m=0.06, score=score, rectangle=0,
                 imagined_base_from_tcp=np.eye(4), terms={})  # fmt: skip
    return Detections.model_construct(grasps=(best, best.model_copy(update={"score": 0.1})))


def _failed(code: Code) -> CycleFailure:
    return CycleFailure(code, "")


GOOD, WEAK = _grasps(0.80), _grasps(0.60)
_NOTHING = ""
_AUTO, _ONCE, _TWICE = (), ("capture.views=1",), ("capture.views=2",)


@pytest.mark.parametrize(
    ("outcome", "looks", "settings", "why"),
    [
        (GOOD, 1, _AUTO, _NOTHING),
        (WEAK, 1, _AUTO, "the best grasp scores only 0.60"),
        (WEAK, 2, _AUTO, "the best grasp scores only 0.60"),
        (WEAK, 3, _AUTO, _NOTHING),
        (WEAK, 1, ("capture.most_views=1",), _NOTHING),
        (WEAK, 4, ("capture.most_views=5",), "the best grasp scores only 0.60"),
        (WEAK, 1, ("capture.weak_score=0.5",), _NOTHING),
        (GOOD, 1, ("capture.weak_score=0.9",), "the best grasp scores only 0.80"),
        (WEAK, 1, _ONCE, _NOTHING),
        (WEAK, 2, _TWICE, _NOTHING),
        (_failed(Code.NO_GRASP), 1, _AUTO, "there is no grasp"),
        (_failed(Code.NO_GRASP), 3, _AUTO, _NOTHING),
        (_failed(Code.NO_GRASP), 1, _ONCE, _NOTHING),
        (_failed(Code.NO_GRASP), 2, _TWICE, _NOTHING),
        (_failed(Code.NOT_SEEN), 1, _AUTO, "too little was seen"),
        (_failed(Code.NO_DEPTH), 1, _AUTO, "something has no depth"),
        (_failed(Code.TOO_NEAR), 1, _AUTO, "something is too near to the camera"),
        (_failed(Code.NO_TABLE), 1, _AUTO, "no table was seen"),
        (_failed(Code.TABLE_MOVED), 1, _AUTO, "the table seems to lie elsewhere"),
        (_failed(Code.COLLISION), 1, _AUTO, "no way to grasp is free"),
        (_failed(Code.UNREACHABLE), 2, _AUTO, "no way to grasp is reached"),
    ],
)
def test_another_look_is_taken_for_what_it_may_mend(
    outcome: Detections | CycleFailure, looks: int, settings: tuple[str, ...], why: str
) -> None:
    assert why_look_again(outcome, looks, load_station(None, settings)) == why


@pytest.mark.parametrize(
    "code", sorted({*FAULTS, Code.STOPPED, Code.NO_OBJECT, Code.TARGET_NOT_FOUND, Code.SPEND_LIMIT, Code.MODEL_ACCESS})
)
def test_no_look_mends_a_fault_a_stop_an_empty_table_or_a_refusal(code: Code) -> None:
    assert why_look_again(_failed(code), 1, load_station()) == ""


def test_a_hosted_model_is_not_paid_again_for_a_weak_grasp_but_for_none() -> None:
    assert why_look_again(WEAK, 1, load_station(), is_hosted=True) == ""
    assert why_look_again(_failed(Code.NO_GRASP), 1, load_station(), is_hosted=True) == "there is no grasp"


@pytest.mark.parametrize(("settings", "looks"), [(_AUTO, 1), (_ONCE, 1), (_TWICE, 2), (("capture.views=3",), 3)])
def test_so_many_looks_are_taken_in_any_case(settings: tuple[str, ...], looks: int) -> None:
    assert asked_for(load_station(None, settings)) == looks


# --- as often as it is worth it ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def tall(devices_and_settings: tuple[Devices, list[str]]) -> CycleRecord:
    """A cycle with a cylinder whose top the first look cannot see."""
    return Bench(*devices_and_settings).pick("tall")


def test_what_one_look_cannot_grasp_is_looked_at_again_and_picked(tall: CycleRecord) -> None:
    assert tall.result is not None and tall.result.result == "SUCCESS", tall.result
    assert list(tall.result.stages) == ["capture", "detect", "plan", "execute", "verify", "deliver"]


def test_every_look_is_recorded_with_its_reason(tall: CycleRecord) -> None:
    first, *further = tall.looks
    assert first.view.why == "" and np.allclose(first.view.q_rad, CAPTURE, atol=1e-3)
    assert 1 <= len(further) <= 2
    assert further[0].view.why in ("something has no depth", "too little was seen")
    stamps = [look.view.stamp_ns for look in tall.looks]
    assert stamps == sorted(set(stamps)), "each has a frame of its own"
    poses = [look.view.base_from_color for look in tall.looks]
    assert all(np.degrees(np.arccos(pose[:3, 2] @ poses[0][:3, 2])) > 25 for pose in poses[1:])


def test_detect_and_plan_are_those_of_all_looks(tall: CycleRecord) -> None:
    found = tall.stages["detect"].result
    assert isinstance(found, Detections)
    assert len(found.scene.look_labels) == len(tall.looks) and found.scene.mount is not None
    planned = tall.stages["plan"].result
    assert isinstance(planned, PickPlan)
    reach = planned.segments[0].trajectory
    assert np.array_equal(reach.start_q_rad, tall.looks[-1].view.q_rad), "from where the last look was taken"


def test_a_replay_is_equal(tall: CycleRecord) -> None:
    again = replay(tall, Request())
    assert again.equal and [stage.stage for stage in again.stages] == ["detect", "plan", "verify"]


def test_what_would_one_look_have_chosen(tall: CycleRecord) -> None:
    one = replay(tall, Request(("capture.views=1",)))
    (detected,) = one.stages
    assert isinstance(detected.replayed, Failure) and detected.replayed.code in (Code.NO_DEPTH, Code.NOT_SEEN)
    assert set(one.not_reached) == {"plan", "verify"}


@pytest.mark.parametrize("stage", ["plan", "verify"])
def test_a_stage_that_is_run_alone_keeps_the_looks_of_its_detection(tall: CycleRecord, stage: str) -> None:
    assert replay(tall, Request.of(["capture.views=1"], None, stage)).equal


def test_what_one_look_can_grasp_is_looked_at_once(bench: Bench) -> None:
    low = bench.pick("low")
    assert low.result is not None and low.result.result == "SUCCESS" and len(low.looks) == 1
    assert bench.stages[1:4] == ["capture", "detect", "plan"]


def test_two_looks_are_taken_always_when_they_are_asked_for(bench: Bench) -> None:
    low = bench.pick("low", "capture.views=2")
    assert [look.view.why for look in low.looks] == ["", "2 looks are asked for"]
    assert low.result is not None and low.result.result == "SUCCESS"
    assert bench.stages[1:5] == ["capture", "capture", "detect", "plan"], "nothing is decided before the second"


def test_looks_that_do_not_help_end_with_the_reason_and_the_arm_where_it_began(bench: Bench) -> None:
    none = bench.pick("low", _IN_VAIN)
    assert none.result is not None and (none.result.result, none.result.code) == ("FAILED", Code.TABLE_MOVED)
    assert [look.view.why for look in none.looks] == ["", *2 * ["the table seems to lie elsewhere"]]
    assert none.result.stages.keys() == {"capture", "detect"}
    assert bench.arm.motions == 3 and _at_capture_pose(bench)


def test_without_another_place_to_look_from_the_first_look_decides(bench: Bench) -> None:
    """Where objects may reach up to the hand, it cannot move beside them."""
    none = bench.pick("low", _IN_VAIN, "scene.max_height_m=0.62")
    assert none.result is not None and none.result.code == Code.TABLE_MOVED and len(none.looks) == 1
    (event,) = (said.message for said in none.events)
    assert event.code == Code.UNREACHABLE and event.text.startswith("The camera reaches no other place to look from: ")
    assert bench.arm.motions == 0


# --- stopped on the way -----------------------------------------------------------------------------------------------


def _stop_in(bench: Bench, actions: Actions, stage: str, after_ticks: int) -> None:
    """Stop in the middle of a motion that is made in this stage."""
    left = after_ticks

    def tick() -> None:
        nonlocal left
        if bench.stages and bench.stages[-1] == stage:
            left -= 1
            if left == 0:
                actions.halt_devices()

    bench.tick = tick


BEFORE, AFTER = ("capture", 1), ("detect", 2)
"""On the way to a second look, which is the first motion; on the way back, the second one."""


@pytest.mark.parametrize(("stage", "motion"), [BEFORE, AFTER], ids=["there", "back"])
def test_a_stop_between_looks_ends_the_cycle_and_nothing_moves_afterwards(
    bench: Bench, stage: str, motion: int
) -> None:
    actions = bench.actions(*_TWO_IN_VAIN)
    _stop_in(bench, actions, stage, 150)
    stopped = bench.stopped(actions, "low")
    assert stopped.result is not None and (stopped.result.result, stopped.result.code) == ("ABORTED", Code.STOPPED)
    assert len(stopped.looks) == bench.arm.motions == motion
    state = bench.arm.state()
    assert state.mode is ArmMode.IDLE and np.abs(state.dq_rad_s).max() < 0.01 and not _at_capture_pose(bench)


@pytest.mark.parametrize("motion", [BEFORE[1], AFTER[1]], ids=["there", "back"])
def test_a_reflex_between_looks_is_the_cycles_failure(bench: Bench, motion: int) -> None:
    actions = bench.actions(*_TWO_IN_VAIN)
    bench.arm.reflex_in = motion
    aborted = bench.stopped(actions, "low")
    assert aborted.result is not None and bench.arm.motions == motion
    assert (aborted.result.result, aborted.result.code) == ("ABORTED", Code.ARM_REFLEX)


def test_after_a_reflex_on_the_way_to_a_third_look_nothing_moves(bench: Bench) -> None:
    actions = bench.actions(_IN_VAIN, "capture.most_views=3")
    bench.arm.reflex_in = 2
    aborted = bench.stopped(actions, "low")
    assert aborted.result is not None and aborted.result.code is Code.ARM_REFLEX
    assert bench.arm.motions == 2, "the way back is for an arm that may move"
