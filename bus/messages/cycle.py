"""One try of a pick: its attempt, its stages, its result."""

from __future__ import annotations

from typing import Generic, Literal, TypeVar

from bus.arrays import Transform, Vector3
from bus.codes import Code
from bus.errors import CycleFailure
from bus.frozen import Message
from bus.messages.approval import Approval
from bus.messages.job import Job
from bus.rejection import Rejection

StageName = Literal["capture", "detect", "plan", "approve", "execute", "verify", "deliver"]
ResultT = TypeVar("ResultT", bound=Message)


class EarlierAttempt(Message):
    """A cycle of the same pick before this one.

    Attributes:
        cycle_id: of that cycle.
        code: why it failed; None when it cleared the way for this one. ``reason``: in words.
    """

    cycle_id: str
    code: Code | None
    reason: str


class Attempt(Message):
    """The beginning of a cycle: the first try of a pick, or a retry (`cell.daemon.retry`).

    Attributes:
        cycle_id: of this cycle.
        number: 0 = the first. ``retry_of``: id of the cycle before, "" for the first.
        missed: ``base_from_tcp`` (4, 4) of grasps that closed on nothing, or met something on the way there, in earlier
            cycles; planning leaves them out.
        failed_at: (3,) places in ``base`` where earlier picks until empty failed for good: what is there is no target.
        job: what this cycle is asked for. ``then``: while it clears the way, the jobs that follow it, the next one
            first.
        earlier: the cycles of this pick before, in order.
        asked_by: ``client_id`` of the command that asked for it, which begins with the interface; "" = not known.
    """

    cycle_id: str
    number: int = 0
    retry_of: str = ""
    missed: tuple[Transform, ...] = ()
    failed_at: tuple[Vector3, ...] = ()
    job: Job = Job()
    then: tuple[Job, ...] = ()
    earlier: tuple[EarlierAttempt, ...] = ()
    asked_by: str = ""


class Failure(Message):
    """The failure with which a stage ended the cycle.

    Attributes:
        code: the kind of failure. ``text``: what happened, with its measurements.
        rejected: from the plan stage, every way to grasp that is not feasible.
        obstacle_m: (3,) of OBSTRUCTED, the top of what lies on the target, in ``base``.
    """

    code: Code
    text: str
    rejected: tuple[Rejection, ...] = ()
    obstacle_m: Vector3 | None = None

    @classmethod
    def of(cls, error: CycleFailure) -> Failure:
        """Make the message from the error that a stage raised."""
        return cls(code=error.failure, text=error.text, rejected=tuple(error.rejected), obstacle_m=error.obstacle_m)


class StageRecord(Message, Generic[ResultT]):
    """Record of one stage of one cycle, published and recorded under ``cycle/{stage}``.

    Exactly one of ``result`` and ``failure`` is set.

    Attributes:
        cycle_id: of the cycle. ``stage``: of it.
        result: what the stage found out. ``failure``: why it ended the cycle.
        started_ns: UTC.
        duration_s: wall time.
    """

    cycle_id: str
    stage: StageName
    started_ns: int
    duration_s: float
    result: ResultT | None
    failure: Failure | None


class FoundThing(Message):
    """The thing that a cycle went for.

    Attributes:
        text: its colours, size and place, in words.
        top_m: (3,) its highest point in ``base``. ``size_m``: (3,) length, width and height of the box around it.
    """

    text: str
    top_m: Vector3
    size_m: Vector3


class GraspOutcome(Message):
    """The grasp that was executed, and what the hand felt.

    Attributes:
        base_from_tcp: (4, 4) as planned. ``score``: of the proposal.
        width_m: between the pads when they had closed; None when they never did.
        load_n: vertical force of what was held; None when it was not measured.
    """

    base_from_tcp: Transform
    score: float
    width_m: float | None = None
    load_n: float | None = None


class Laid(Message):
    """The place where a held object was let go. ``place``: name of the station's place, "" for its tray or a position.

    Attributes:
        position_m: (3,) of the tcp in ``base``.
    """

    place: str
    position_m: Vector3


class CycleResult(Message):
    """The result of one cycle, the same for every client and protocol.

    Attributes:
        cycle_id: its recording is named so.
        result: ``EMPTY``: nothing was there to pick.
        code: why it did not succeed; None on success.
        reason: the same in words; on success what was measured.
        wall_s: how long the cycle took.
        object: name of the presented object in simulation, "" on hardware.
        stages: wall time of each stage that ran [s].
        recording: path of the MCAP.
        retried_as: id of the cycle that tries again, or goes on after clearing the way; "" when this one was the last.
        advice: what to do about ``code``.
        job: what was asked for; ``found``: what the cycle went for. ``grasp``: as executed; ``laid``: where it let go.
        earlier: the cycles of the same pick before this one.
        approvals: what was answered to each proposal, where a person approves motion (``execute.approve``).
        asked_by: as in `Attempt`.
    """

    cycle_id: str
    object: str
    result: Literal["SUCCESS", "FAILED", "ABORTED", "EMPTY"]
    code: Code | None
    reason: str
    stages: dict[str, float]
    wall_s: float
    recording: str
    retried_as: str = ""
    advice: str = ""
    job: Job = Job()
    found: FoundThing | None = None
    grasp: GraspOutcome | None = None
    laid: Laid | None = None
    earlier: tuple[EarlierAttempt, ...] = ()
    approvals: tuple[Approval, ...] = ()
    asked_by: str = ""
