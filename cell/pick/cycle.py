"""One cycle: capture -> detect -> plan -> execute -> verify, then deliver. Stages are timed, published and recorded."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from bus import topics
from bus.arrays import Transform
from bus.codes import ADVICE, DROPPED_BY_JOB, Code
from bus.errors import CycleFailure
from bus.messages import (
    Attempt,
    CycleResult,
    Detections,
    Execution,
    FoundThing,
    Grasp,
    HandState,
    Laid,
    Observation,
    PickPlan,
    Verdict,
)
from cell.pick.approving import Approvals
from cell.pick.choosing import Choosing
from cell.pick.equipment import Equipment
from cell.pick.execute import deliver, execute
from cell.pick.mounting import FEWEST_LOOKS
from cell.pick.outcome import found_thing, grasp_outcome, laid_at
from cell.pick.plan import scenes
from cell.pick.several import one_thing
from cell.pick.stages import FAULTS, Stages
from cell.pick.touching import Thing
from cell.pick.verify import lost_on_the_way, verify
from config.job import place_of
from perception.fusion.agreed import corrected


@dataclass
class Cycle:
    """The state of one pick, from its start to its result.

    Attributes:
        attempt: the attempt of the pick that it is.
        object: name of the presented object in simulation, "" on hardware.
        verdict: the result of verify, or None.
        grasp: base_from_tcp (4, 4) of the planned grasp, or None.
        laid: where the object was let go, or None.
        approvals: asks a person before the arm moves for a grasp, where the station wants it.
    """

    attempt: Attempt
    equipment: Equipment
    stages: Stages
    object: str = ""
    verdict: Verdict | None = None
    grasp: Transform | None = None
    laid: Laid | None = None
    approvals: Approvals = field(default_factory=Approvals)
    _found: Detections | None = None
    _target: Grasp | None = None
    _planned: tuple[PickPlan, Grasp] | None = None
    _grasped: HandState | None = None
    _choosing: Choosing | None = None
    _started_s: float = field(default_factory=time.monotonic)

    @property
    def cycle_id(self) -> str:
        """The id of the cycle."""
        return self.attempt.cycle_id

    @property
    def code(self) -> Code | None:
        """The code of its failure so far; None for none."""
        return self._outcome()[1]

    @property
    def reason(self) -> str:
        """The reason why it ended so, in words."""
        return self._outcome()[2]

    def run(self) -> None:
        """Run the five stages. Raises: CycleFailure, already published and kept in ``stages.failure``."""
        e, choosing = self.equipment, Choosing(self.attempt, self.equipment, self.stages, self.approvals)
        self._choosing = choosing
        try:
            found, chosen = choosing.choose()
        finally:
            if choosing.planned is not None:  # perhaps it was not approved
                self._found, self._target = choosing.planned.found, choosing.planned.grasp
                self.grasp = self._target.base_from_tcp
        before, grasp = choosing.looks[found.scene.shown], found.grasps[chosen.grasp]
        self._planned = (chosen, grasp)
        thing = _thing(found, choosing.looks, grasp, e)
        after: Observation | None = None

        def act() -> Execution:
            nonlocal after
            self.stages.withdrawal.begin_grasp()
            execution, after = execute(
                chosen, grasp, (e.arm, e.hand), choosing.observe, e.robot, e.station, self.stages.gate, thing
            )
            return execution

        execution = self.stages.run("execute", topics.EXECUTE, act)
        self._grasped = execution.grasped
        if execution.stopped_in is not None:
            raise self.stages.fail(CycleFailure(Code.STOPPED, f"Stopped during {execution.stopped_in!r}."))
        self.verdict = self.stages.run(
            "verify", topics.VERIFY, lambda: verify(execution, found, grasp, before, after, e.robot, e.station)
        )
        if found.scene.mount is not None and len(choosing.looks) >= FEWEST_LOOKS:
            e.mounting.take(found.scene.mount)

    def interrupt(self) -> None:
        """End the cycle before its delivery, after a stop or abort, whatever its verdict; its cause is the reason."""
        cause, failure = self.stages.gate.cause, self.stages.failure
        if cause is not None and (failure is None or failure.code in (Code.STOPPED, Code.NODE_LOST)):
            self.stages.fail(cause)
        elif failure is None:
            self.stages.fail(CycleFailure(Code.STOPPED, "The cycle was stopped before it was over."))

    def deliver(self) -> None:
        """Lay the held object into the tray after the verdict; or only open an empty hand.

        An object that was held, but is not in the hand before the release, counts as dropped.
        """
        e, planned = self.equipment, self._planned
        if planned is None or self.verdict is None:
            return
        if self.verdict.code is Code.CONTACT and self._choosing is not None:  # it is where it took its last look
            self._choosing.go_back(CycleFailure(Code.CONTACT, self.verdict.reason))
            return
        done = self.stages.run(
            "deliver", topics.DELIVER, lambda: deliver(*planned, (e.arm, e.hand), e.station, self.stages.gate)
        )
        carried = [run.hand for run in done.runs if run.name == "place"]
        if self.verdict.held and self._grasped is not None and carried:
            lost = lost_on_the_way(self._grasped, carried[-1], e.station)
            if lost:
                self.stages.fail(CycleFailure(Code.DROPPED, lost))
                return
        if self.verdict.held or self.verdict.code is Code.MULTI_PICK:  # they all lie there now
            self.laid = laid_at(done, e.robot, place_of(self.attempt.job))

    def result(self, retried_as: str) -> CycleResult:
        """Return the result of the cycle; the caller publishes it as the last message of the cycle."""
        self.stages.settle()
        outcome, code, reason = self._outcome()
        grasp = self._planned[1] if self._planned is not None else None
        return CycleResult(
            cycle_id=self.cycle_id,
            object=self.object,
            result=outcome,
            code=code,
            reason=reason,
            stages=dict(self.stages.took_s),
            wall_s=time.monotonic() - self._started_s,
            recording=str(self.stages.log.path),
            retried_as=retried_as,
            advice=self._advice(),
            job=self.attempt.job,
            found=self._found_thing(),
            grasp=grasp_outcome(grasp, self._grasped, self.verdict) if grasp is not None else None,
            laid=self.laid,
            earlier=self.attempt.earlier,
            approvals=tuple(self.stages.approvals),
            asked_by=self.attempt.asked_by,
        )

    def _advice(self) -> str:
        """Return the advice for its end: of a failure its own, of a verdict that of its code."""
        code = self.code
        if code is Code.DROPPED and self.attempt.job.grasp.max_force_n is not None:
            return DROPPED_BY_JOB
        if code is None or self.stages.failure is not None:
            return self.stages.advice if code is not None else ""
        return ADVICE[code]

    def _found_thing(self) -> FoundThing | None:
        found, grasp = self._found, self._target
        return found_thing(found, grasp) if found is not None and grasp is not None else None

    def _outcome(self) -> tuple[Literal["SUCCESS", "FAILED", "ABORTED", "EMPTY"], Code | None, str]:
        failure = self.stages.failure
        if failure is not None:
            code = failure.code
            if code is Code.NO_OBJECT and "detect" in self.stages.took_s:
                return "EMPTY", code, failure.text
            return ("ABORTED" if code is Code.STOPPED or code in FAULTS else "FAILED"), code, failure.text
        assert self.verdict is not None, "a cycle without a verdict has a failure"
        return ("SUCCESS" if self.verdict.held else "FAILED"), self.verdict.code, self.verdict.reason


def _thing(found: Detections, looks: Sequence[Observation], grasp: Grasp, equipment: Equipment) -> Thing:
    """Return the thing that is grasped: its top as it was seen, and its scene."""
    tops_m = [float(one.top_m[2]) for one in found.scene.instances if one.number == grasp.instance]
    scene_of = scenes(found, looks, equipment.robot, equipment.station)
    shown = corrected(looks[found.scene.shown], found.scene.mount)
    return Thing(tops_m[0] if tops_m else None, lambda: scene_of(grasp), lambda: one_thing(found, grasp, shown))
