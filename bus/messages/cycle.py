"""One try of a pick: its attempt, its stages, its result."""

from __future__ import annotations

from typing import Generic, Literal, TypeVar

from bus.arrays import Transform, Vector3
from bus.codes import Code
from bus.errors import CycleFailure
from bus.frozen import Message
from bus.rejection import Rejection

StageName = Literal["capture", "detect", "plan", "execute", "verify", "deliver"]
ResultT = TypeVar("ResultT", bound=Message)


class Attempt(Message):
    """The beginning of a cycle: the first try of a pick, or a retry (`cell.daemon.retry`).

    Attributes:
        number: 0 = the first. ``retry_of``: id of the cycle before, "" for the first.
        missed: ``base_from_tcp`` (4, 4) of grasps that closed on nothing, or met something on the way there, in earlier
            cycles; planning leaves them out.
        failed_at: (3,) places in ``base`` where earlier picks until empty failed for good: what is there is no target.
    """

    cycle_id: str
    number: int = 0
    retry_of: str = ""
    missed: tuple[Transform, ...] = ()
    failed_at: tuple[Vector3, ...] = ()


class Failure(Message):
    """Why a stage ended the cycle. ``rejected``: from the plan stage, every way to grasp that is not feasible."""

    code: Code
    text: str
    rejected: tuple[Rejection, ...] = ()

    @classmethod
    def of(cls, error: CycleFailure) -> Failure:
        """Make the message from the error that a stage raised."""
        return cls(code=error.failure, text=error.text, rejected=tuple(error.rejected))


class StageRecord(Message, Generic[ResultT]):
    """Record of one stage of one cycle, published and recorded under ``cycle/{stage}``.

    Exactly one of ``result`` and ``failure`` is set.

    Attributes:
        started_ns: UTC.
        duration_s: wall time.
    """

    cycle_id: str
    stage: StageName
    started_ns: int
    duration_s: float
    result: ResultT | None
    failure: Failure | None


class CycleResult(Message):
    """The result of one cycle.

    Attributes:
        object: name of the presented object in simulation, "" on hardware.
        stages: wall time of each stage that ran [s].
        recording: path of the MCAP.
        retried_as: id of the cycle that tries again; "" when this one was the last.
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
