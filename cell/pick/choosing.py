"""Chooses what to pick and how: looks, detects and plans, and looks again from another place where that may help."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from bus import topics
from bus.arrays import Transform
from bus.codes import Code
from bus.commands import Event
from bus.errors import BusError, CycleFailure, DriverError
from bus.messages import Attempt, Detections, ModelReply, Observation, ObservedScene, PickPlan, SeenMount, View
from bus.sensor_codec import transforms_to_wire
from cell.pick.approving import Approvals, Planned, approved
from cell.pick.capture import capture, require_sight
from cell.pick.detect import detect_unless_halted
from cell.pick.equipment import Equipment
from cell.pick.looking import asked_for, go, way_back, way_to_next_look, why_look_again
from cell.pick.outcome import lays_at
from cell.pick.plan import plan
from cell.pick.stages import FAULTS, Stages
from config.job import place_of


@dataclass
class Choosing:
    """The looks of one cycle, and what is chosen in them.

    Attributes:
        looks: the observations so far, the first from the capture pose.
        approvals: asks a person, where the station wants it.
        planned: the last plan, and what it was made of; None before there is one.
    """

    attempt: Attempt
    equipment: Equipment
    stages: Stages
    approvals: Approvals = field(default_factory=Approvals)
    looks: list[Observation] = field(default_factory=list)
    planned: Planned | None = None
    _mount: SeenMount | None = None
    _seen_ns: int = 0

    def choose(self) -> tuple[Detections, PickPlan]:
        """Look as often as it takes, detect and plan; then ask a person, where the station wants it.

        Raises: CycleFailure; unless a device or the cell failed, with the arm back at the capture pose.
        """
        self._look()
        try:
            for number in range(2, asked_for(self.equipment.station) + 1):
                self._look_again(f"{number} looks are asked for")
            while True:
                chosen = self._detect_and_plan()
                if chosen is not None:
                    return chosen[0], self._approved(*chosen)
        except CycleFailure as failure:
            if not self.stages.gate.halted and failure.failure not in FAULTS:
                self.go_back(failure)
            raise
        finally:
            if self._mount is not None:
                self.stages.tell(self.equipment.mounting.news(self._mount))

    def observe(self) -> Observation:
        """Capture a frame newer than the last one. Raises: StaleFrame."""
        e = self.equipment
        oldest_ns = time.time_ns() - round(e.station.camera.max_age_s * 1e9)
        seen = e.mounting.applied(capture(e.camera, e.arm, e.robot, max(oldest_ns, self._seen_ns)))
        require_sight(seen.frame)
        self._seen_ns = seen.frame.stamp_ns
        return seen

    # --- looking ------------------------------------------------------------------------------------------------------

    def _look(self, why: str = "", go_there: Callable[[], None] = lambda: None) -> None:
        """Run the capture stage; its record holds the view, the frame travels as images.

        Args:
            why: the reason of a further look. ``go_there``: moves the arm to where it is taken.
        """

        def look() -> View:
            go_there()
            seen = self.observe()
            self.looks.append(seen.model_copy(update={"view": seen.view.model_copy(update={"why": why})}))
            return self.looks[-1].view

        view = self.stages.run("capture", topics.CAPTURE, look)
        self.stages.publish(topics.TF, transforms_to_wire(
            {("base", "color"): view.base_from_color}, view.stamp_ns).SerializeToString())  # fmt: skip

    def _look_again(self, why: str) -> bool:
        """Take one more look, if there is a reason and a reachable place; the failure that gave the reason is over."""
        e, gate = self.equipment, self.stages.gate
        if not why:
            return False
        try:
            way = way_to_next_look(self.looks, e.robot, e.station, self.stages.cancel)
        except CycleFailure as failure:
            if failure.failure is Code.STOPPED:
                raise self.stages.fail(failure) from failure.__cause__
            self.stages.tell(Event(code=failure.failure, severity="info", text=failure.text))
            return False
        self.stages.failure = None
        self._look(why, lambda: go(e.arm, gate, way))
        return True

    def go_back(self, why: CycleFailure) -> None:
        """Move from the last look to the capture pose. Raises: CycleFailure, a fault, when it does not get there."""
        if len(self.looks) < 2:
            return
        e, gate = self.equipment, self.stages.gate
        try:
            go(e.arm, gate, way_back(self.looks, e.robot, e.station, gate.cancel))
        except CycleFailure as error:
            if error.failure is Code.STOPPED:
                raise self.stages.fail(error) from error
            text = f"{why.text} And the arm has no way back to the capture pose: {error.text}"
            raise self.stages.fail(CycleFailure(Code.MOTION_REFUSED, text)) from error
        except (DriverError, BusError) as error:
            raise self.stages.fail(error) from error

    # --- detecting and planning ---------------------------------------------------------------------------------------

    def _detect_and_plan(self) -> tuple[Detections, PickPlan] | None:
        """Return what to do, or None after another look, which is taken when it may mend a failure or a weak grasp."""
        e, looks = self.equipment, self.looks
        try:
            found = self.stages.run("detect", topics.DETECT, self._detect, meanwhile=True)
            is_hosted = e.models.imaginer.is_hosted
            if self._look_again(why_look_again(found, len(looks), e.station, is_hosted=is_hosted)):
                return None
            chosen = self._plan(found)
        except CycleFailure as failure:
            if not self._look_again(why_look_again(failure, len(looks), e.station)):
                raise
            return None
        return found, chosen

    def _plan(self, found: Detections, passed_over: tuple[Transform, ...] = ()) -> PickPlan:
        e, missed = self.equipment, (*self.attempt.missed, *passed_over)
        return self.stages.run(
            "plan", topics.PLAN, lambda: plan(found, self.looks, e.robot, e.station, missed, self.stages.cancel)
        )

    def _approved(self, found: Detections, chosen: PickPlan) -> PickPlan:
        """The plan that a person approved, where the station wants it; else the chosen one. Raises: CycleFailure."""
        settings, robot, place = self.equipment.station.execute, self.equipment.robot, place_of(self.attempt.job)

        def planned(plan: PickPlan, passed_over: int = 0) -> Planned:
            is_asked = settings.approve != "no"
            until_ns = time.time_ns() + round(settings.approve_s * 1e9) if is_asked else 0
            looks, lays_m = tuple(self.looks), lays_at(plan, robot)
            self.planned = Planned(self.attempt.cycle_id, found, plan, looks, passed_over, until_ns, place, lays_m)
            self.approvals.last = self.planned
            return self.planned

        first = planned(chosen)
        if settings.approve == "no":
            return chosen
        another = lambda passed_over: planned(self._plan(found, passed_over), len(passed_over))  # noqa: E731
        return approved(self.stages, self.approvals, first, another, settings.approve_s).plan

    def _detect(self) -> Detections:
        """Detect; what was seen is published alone when there is no result to hold it."""
        e, seen, cancel = self.equipment, list[ObservedScene](), self.stages.cancel

        def say_reply(reply: ModelReply) -> None:
            self.stages.publish(topics.MODEL_REPLY, reply)

        try:
            return detect_unless_halted(
                self.looks,
                e.station,
                e.models,
                say_reply,
                lambda: cancel.is_set,
                seen.append,
                is_again="detect" in self.stages.took_s,
                failed_at=self.attempt.failed_at,
            )
        except CycleFailure:
            for scene in seen:
                self.stages.publish(topics.SCENE, scene)
            raise
        finally:
            for scene in seen:
                self._mount = scene.mount
