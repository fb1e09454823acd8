"""One cycle: capture -> detect -> plan -> execute -> verify, then deliver. Stages are timed, published and recorded."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, TypeVar

from bus import topics
from bus.arrays import Transform
from bus.codes import Code
from bus.commands import Event
from bus.errors import (
    ArmReflex,
    BadFrame,
    BusError,
    CycleFailure,
    DeviceLost,
    DriverError,
    HandFault,
    MotionRefused,
    RecordingError,
    StaleFrame,
)
from bus.frozen import Message
from bus.messages import (
    Attempt,
    CycleResult,
    Detections,
    Execution,
    Failure,
    Grasp,
    HandState,
    ModelReply,
    Observation,
    ObservedScene,
    PickPlan,
    SeenMount,
    StageName,
    Verdict,
    View,
)
from bus.sensor_codec import transforms_to_wire
from bus.topics import Topic
from cell.machine.gate import Gate
from cell.pick.capture import capture, require_sight
from cell.pick.detect import detect_unless_halted
from cell.pick.execute import deliver, execute
from cell.pick.looking import asked_for, go, way_back, way_to_next_look, why_look_again
from cell.pick.mounting import FEWEST_LOOKS, MountKeeper
from cell.pick.plan import plan
from cell.pick.record import CycleLog
from cell.pick.verify import lost_on_the_way, verify
from config.schema import Station
from drivers.interface import Arm, Camera, Hand
from perception.models import Models
from planning.robot import Robot

ResultT = TypeVar("ResultT", bound=Message)
Publish = Callable[[Topic, "Message | bytes"], None]

FAULTS = {Code.ARM_REFLEX, Code.MOTION_REFUSED, Code.HAND_FAULT, Code.STALE_FRAME, Code.BAD_FRAME, Code.DEVICE_LOST,
          Code.NODE_LOST, Code.RECORDING, Code.INTERNAL}  # fmt: skip
"""Codes that abort the machine: a device or the cell itself failed, not the pick."""

_CODE_OF_ERROR: tuple[tuple[type[Exception], Code], ...] = (
    (ArmReflex, Code.ARM_REFLEX),
    (MotionRefused, Code.MOTION_REFUSED),
    (HandFault, Code.HAND_FAULT),
    (StaleFrame, Code.STALE_FRAME),
    (BadFrame, Code.BAD_FRAME),
    (DeviceLost, Code.DEVICE_LOST),
    (BusError, Code.NODE_LOST),
    (DriverError, Code.INTERNAL),
    (RecordingError, Code.RECORDING),
)


@dataclass(frozen=True)
class Equipment:
    """The devices, models and settings of a cycle."""

    camera: Camera
    arm: Arm
    hand: Hand
    robot: Robot
    station: Station
    models: Models
    mounting: MountKeeper = field(default_factory=MountKeeper)


@dataclass
class Cycle:
    """The state of one pick, from its start to its result.

    Attributes:
        attempt: the attempt of the pick that it is.
        object: name of the presented object in simulation, "" on hardware.
        stages: wall time of every stage that ran [s].
        failure: why it ended early, or None.
        verdict: the result of verify, or None.
        grasp: base_from_tcp (4, 4) of the planned grasp, or None.
    """

    attempt: Attempt
    equipment: Equipment
    publish: Publish
    on_stage: Callable[[str], None]
    log: CycleLog
    gate: Gate
    object: str = ""
    stages: dict[str, float] = field(default_factory=dict)
    failure: Failure | None = None
    verdict: Verdict | None = None
    grasp: Transform | None = None
    _planned: tuple[PickPlan, Grasp] | None = None
    _grasped: HandState | None = None
    _mount: SeenMount | None = None
    _seen_ns: int = 0
    _started_s: float = field(default_factory=time.monotonic)

    @property
    def cycle_id(self) -> str:
        """The id of the cycle."""
        return self.attempt.cycle_id

    @property
    def code(self) -> Code | None:
        """The code of its failure so far; None for none."""
        return self._outcome()[1]

    def run(self) -> None:
        """Run the five stages. Raises: CycleFailure, already published and kept in `failure`."""
        e = self.equipment
        looks, found, chosen = self._choose()
        before = looks[found.scene.shown]
        grasp = found.grasps[chosen.grasp]
        self._planned, self.grasp = (chosen, grasp), grasp.base_from_tcp
        after: Observation | None = None

        def act() -> Execution:
            nonlocal after
            execution, after = execute(chosen, grasp, (e.arm, e.hand), self._observe, e.robot, e.station, self.gate)
            return execution

        execution = self._stage("execute", topics.EXECUTE, act)
        self._grasped = execution.grasped
        if execution.stopped_in is not None or after is None:
            raise self.fail(CycleFailure(Code.STOPPED, f"Stopped during {execution.stopped_in!r}."))
        seen = after
        self.verdict = self._stage(
            "verify", topics.VERIFY, lambda: verify(execution, found, before, seen, e.robot, e.station)
        )
        if found.scene.mount is not None and len(looks) >= FEWEST_LOOKS:
            e.mounting.take(found.scene.mount)

    def interrupt(self) -> None:
        """End the cycle before its delivery, after a stop or abort, whatever its verdict; its cause is the reason."""
        cause, ended_by = self.gate.cause, self.failure.code if self.failure is not None else None
        if cause is not None and ended_by in (None, Code.STOPPED, Code.NODE_LOST):
            self.fail(cause)
        elif self.failure is None:
            self.fail(CycleFailure(Code.STOPPED, "The cycle was stopped before it was over."))

    def deliver(self) -> None:
        """Lay the held object into the tray after the verdict; or only open an empty hand.

        An object that was held, but is not in the hand before the release, counts as dropped.
        """
        e, planned = self.equipment, self._planned
        if planned is None or self.verdict is None:
            return
        done = self._stage("deliver", topics.DELIVER, lambda: deliver(*planned, (e.arm, e.hand), e.station, self.gate))
        carried = [run.hand for run in done.runs if run.name == "place"]
        if self.verdict.held and self._grasped is not None and carried:
            lost = lost_on_the_way(self._grasped, carried[-1], e.station)
            if lost:
                self.fail(CycleFailure(Code.DROPPED, lost))

    def result(self, retried_as: str) -> CycleResult:
        """The result of the cycle; the caller publishes it as the last message of the cycle."""
        outcome, code, reason = self._outcome()
        return CycleResult(
            cycle_id=self.cycle_id,
            object=self.object,
            result=outcome,
            code=code,
            reason=reason,
            stages=dict(self.stages),
            wall_s=time.monotonic() - self._started_s,
            recording=str(self.log.path),
            retried_as=retried_as,
        )

    def _outcome(self) -> tuple[Literal["SUCCESS", "FAILED", "ABORTED", "EMPTY"], Code | None, str]:
        if self.failure is not None:
            code = self.failure.code
            if code is Code.NO_OBJECT and "detect" in self.stages:
                return "EMPTY", code, self.failure.text
            return ("ABORTED" if code is Code.STOPPED or code in FAULTS else "FAILED"), code, self.failure.text
        assert self.verdict is not None, "a cycle without a verdict has a failure"
        return ("SUCCESS" if self.verdict.held else "FAILED"), self.verdict.code, self.verdict.reason

    # --- looking ------------------------------------------------------------------------------------------------------

    def _choose(self) -> tuple[list[Observation], Detections, PickPlan]:
        """Look as often as it takes, detect and plan.

        Raises: CycleFailure; unless a device or the cell failed, with the arm back at the capture pose.
        """
        looks = [self._look()]
        try:
            for number in range(2, asked_for(self.equipment.station) + 1):
                self._look_again(looks, f"{number} looks are asked for")
            while True:
                chosen = self._detect_and_plan(looks)
                if chosen is not None:
                    return looks, *chosen
        except CycleFailure as failure:
            if len(looks) > 1 and not self.gate.halted and failure.failure not in FAULTS:
                self._go_back(looks, failure)
            raise
        finally:
            if self._mount is not None:
                self._tell(self.equipment.mounting.news(self._mount))

    def _go_back(self, looks: list[Observation], why: CycleFailure) -> None:
        """Move back to the capture pose. Raises: CycleFailure, a fault, when the arm does not get there."""
        e = self.equipment
        try:
            go(e.arm, self.gate, way_back(looks, e.robot, e.station, self.gate.cancel))
        except CycleFailure as error:
            if error.failure is Code.STOPPED:
                raise self.fail(error) from error
            text = f"{why.text} And the arm has no way back to the capture pose: {error.text}"
            raise self.fail(CycleFailure(Code.MOTION_REFUSED, text)) from error
        except (DriverError, BusError) as error:
            raise self.fail(error) from error

    def _detect_and_plan(self, looks: list[Observation]) -> tuple[Detections, PickPlan] | None:
        """What to do, or None after another look, which is taken when it may mend a failure or a weak grasp."""
        e = self.equipment
        try:
            found = self._stage("detect", topics.DETECT, lambda: self._detect(looks))
            is_hosted = e.models.imaginer.is_hosted
            if self._look_again(looks, why_look_again(found, len(looks), e.station, is_hosted=is_hosted)):
                return None
            chosen = self._stage(
                "plan",
                topics.PLAN,
                lambda: plan(found, looks, e.robot, e.station, self.attempt.missed, self.gate.cancel),
            )
        except CycleFailure as failure:
            if not self._look_again(looks, why_look_again(failure, len(looks), e.station)):
                raise
            return None
        return found, chosen

    def _look_again(self, looks: list[Observation], why: str) -> bool:
        """Take one more look, if there is a reason and a reachable place; the failure that gave the reason is over."""
        e = self.equipment
        if not why:
            return False
        try:
            way = way_to_next_look(looks, e.robot, e.station, self.gate.cancel)
        except CycleFailure as failure:
            if failure.failure is Code.STOPPED:
                raise self.fail(failure) from failure.__cause__
            self._tell(Event(code=failure.failure, severity="info", text=failure.text))
            return False
        self.failure = None
        looks.append(self._look(why, lambda: go(e.arm, self.gate, way)))
        return True

    # --- stages -------------------------------------------------------------------------------------------------------

    def _detect(self, looks: list[Observation]) -> Detections:
        """Detect; what was seen is published alone when there is no result to hold it."""
        e, seen = self.equipment, list[ObservedScene]()
        try:
            return detect_unless_halted(
                looks,
                e.station,
                e.models,
                self._say_reply,
                lambda: self.gate.halted,
                seen.append,
                is_again="detect" in self.stages,
            )
        except CycleFailure:
            for scene in seen:
                self.publish(topics.SCENE, scene)
            raise
        finally:
            for scene in seen:
                self._mount = scene.mount

    def _tell(self, event: Event | None) -> None:
        if event is not None:
            self.publish(topics.EVENT, event)

    def _say_reply(self, reply: ModelReply) -> None:
        self.publish(topics.MODEL_REPLY, reply)

    def _observe(self) -> Observation:
        """Capture a frame newer than the last one. Raises: StaleFrame."""
        e = self.equipment
        oldest_ns = time.time_ns() - round(e.station.camera.max_age_s * 1e9)
        seen = e.mounting.applied(capture(e.camera, e.arm, e.robot, max(oldest_ns, self._seen_ns)))
        require_sight(seen.frame)
        self._seen_ns = seen.frame.stamp_ns
        return seen

    def _look(self, why: str = "", go_there: Callable[[], None] = lambda: None) -> Observation:
        """Run the capture stage; its record holds the view, the frame travels as images.

        Args:
            why: the reason of a further look. ``go_there``: moves the arm to where it is taken.
        """
        seen: Observation | None = None

        def look() -> View:
            nonlocal seen
            go_there()
            seen = self._observe()
            seen = seen.model_copy(update={"view": seen.view.model_copy(update={"why": why})})
            return seen.view

        view = self._stage("capture", topics.CAPTURE, look)
        self.publish(topics.TF, transforms_to_wire(
            {("base", "color"): view.base_from_color}, view.stamp_ns).SerializeToString())  # fmt: skip
        assert seen is not None
        return seen

    def _stage(self, name: StageName, topic: Topic, work: Callable[[], ResultT]) -> ResultT:
        """Run one stage and publish its outcome. Raises: CycleFailure for everything that ends the cycle."""
        self.log.check()
        if self.gate.halted:
            raise self.fail(CycleFailure(Code.STOPPED, f"Stopped before {name!r}."))
        self.on_stage(name)
        started_ns, started_s = time.time_ns(), time.monotonic()
        result: ResultT | None = None
        failure: CycleFailure | None = None
        try:
            result = work()
        except (CycleFailure, DriverError, BusError, RecordingError) as error:
            failure = self.fail(error)
        except Exception as defect:  # the machine logs it and aborts; the result must name it
            self.fail(CycleFailure(Code.INTERNAL, f"{type(defect).__name__}: {defect}."))
            raise
        took_s = time.monotonic() - started_s
        self.stages[name] = self.stages.get(name, 0.0) + took_s
        record = topic.says(
            cycle_id=self.cycle_id,
            stage=name,
            started_ns=started_ns,
            duration_s=took_s,
            result=result,
            failure=self.failure,
        )
        self.publish(topic, record)
        if failure is not None or result is None:
            raise failure or AssertionError(f"stage {name!r} returned nothing")
        return result

    def fail(self, error: CycleFailure | DriverError | BusError | RecordingError) -> CycleFailure:
        """Keep ``error`` as the cycle's failure and return it as a CycleFailure."""
        if isinstance(error, CycleFailure):
            failure = error
        else:
            code = next(code for kind, code in _CODE_OF_ERROR if isinstance(error, kind))
            failure = CycleFailure(code, error.text)
            failure.__cause__ = error
        self.failure = Failure.of(failure)
        return failure
