"""Runs the stages of one cycle: each is timed, published with its outcome, and ends the cycle when it fails."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

from bus import topics
from bus.cancel import Cancel
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
from bus.messages import Approval, Failure, StageName
from bus.threads import OwnedThread, Role
from bus.topics import Topic
from cell.machine.gate import Gate
from cell.pick.record import CycleLog
from cell.pick.withdrawal import Withdrawal

ResultT = TypeVar("ResultT", bound=Message)
Publish = Callable[[Topic, "Message | bytes"], None]
Ending = CycleFailure | DriverError | BusError | RecordingError
"""Errors that end a cycle."""

FAULTS = {Code.ARM_REFLEX, Code.MOTION_REFUSED, Code.HAND_FAULT, Code.STALE_FRAME, Code.BAD_FRAME, Code.DEVICE_LOST,
          Code.NODE_LOST, Code.RECORDING, Code.INTERNAL}  # fmt: skip
"""Codes that abort the machine: a device or the cell itself failed, not the pick."""

_BEFORE_THE_GRASP = ("capture", "detect", "plan", "approve")

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


@dataclass
class Stages:
    """The stages that one cycle has run.

    Attributes:
        on_stage: called with the name of each as it begins.
        log: the cycle's recording; when it fails, no further stage begins.
        gate: after a stop, no further stage begins. ``withdrawal``: of the job, until its grasp.
        took_s: wall time of every stage that ran.
        failure: why the cycle ends early, or None. ``advice``: what to do about it.
        approvals: what a person answered to its plans, in order.
    """

    cycle_id: str
    publish: Publish
    on_stage: Callable[[str], None]
    log: CycleLog
    gate: Gate
    withdrawal: Withdrawal = field(default_factory=Withdrawal)
    took_s: dict[str, float] = field(default_factory=dict)
    failure: Failure | None = None
    advice: str = ""
    approvals: list[Approval] = field(default_factory=list)
    _publishing: OwnedThread | None = None

    @property
    def cancel(self) -> Cancel:
        """The cancel flag of what is computed before the grasp: set by a stop, and when the job is withdrawn."""
        halt = self.gate.cancel
        return Cancel(lambda: halt.is_set, lambda: self.withdrawal.due() is not None)

    def run(self, name: StageName, topic: Topic, work: Callable[[], ResultT], *, meanwhile: bool = False) -> ResultT:
        """Run one stage and publish its outcome. Raises: CycleFailure for everything that ends the cycle.

        Args:
            meanwhile: a result is published while the next stage computes: packing a detection's images takes as long
                as planning. Records stay in the order of the stages.
        """
        self.log.check()
        if self.gate.halted:
            raise self.fail(CycleFailure(Code.STOPPED, f"Stopped before {name!r}."))
        if name in _BEFORE_THE_GRASP and (due := self.withdrawal.due()) is not None:
            raise self.fail(due)
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
        self.took_s[name] = self.took_s.get(name, 0.0) + took_s
        record = topic.says(
            cycle_id=self.cycle_id,
            stage=name,
            started_ns=started_ns,
            duration_s=took_s,
            result=result,
            failure=self.failure,
        )
        self.settle()
        if meanwhile and failure is None:
            self._publishing = OwnedThread(Role.RECORD, lambda: self.publish(topic, record), of=name).start()
        else:
            self.publish(topic, record)
        if failure is not None or result is None:
            raise failure or AssertionError(f"stage {name!r} returned nothing")
        return result

    def settle(self) -> None:
        """Wait until every record is published."""
        if self._publishing is not None:
            self._publishing.join()
            self._publishing = None

    def fail(self, error: Ending) -> CycleFailure:
        """Keep ``error`` as the cycle's failure and return it as a CycleFailure."""
        if isinstance(error, CycleFailure):
            failure = self._why_stopped(error)
        else:
            code = next(code for kind, code in _CODE_OF_ERROR if isinstance(error, kind))
            failure = CycleFailure(code, error.text)
            failure.__cause__ = error
        self.failure, self.advice = Failure.of(failure), failure.advice
        return failure

    def _why_stopped(self, failure: CycleFailure) -> CycleFailure:
        """The failure; of a computation that was stopped because the job was withdrawn, that."""
        due = self.withdrawal.due()
        return due if due is not None and failure.failure is Code.STOPPED and not self.gate.halted else failure

    def tell(self, event: Event | None) -> None:
        """Publish an event, if there is one."""
        if event is not None:
            self.publish(topics.EVENT, event)
