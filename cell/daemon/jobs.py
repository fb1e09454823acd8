"""The jobs that wait while the cell works, in their order. They live in memory only: no job outlives its daemon."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from bus.commands import CommandRequest
from bus.errors import Refused
from bus.messages import Job
from cell.pick.withdrawal import Withdrawal


@dataclass(frozen=True)
class Ordered:
    """One accepted ``pick`` or ``start``.

    Attributes:
        cycle_id: of its first cycle. ``withdrawal``: its time runs from its acceptance.
    """

    verb: str
    request: CommandRequest
    cycle_id: str
    withdrawal: Withdrawal

    @property
    def job(self) -> Job:
        """Its job, with the id that the cell knows it by."""
        return self.request.job

    @classmethod
    def of(cls, verb: str, request: CommandRequest, cycle_id: str) -> Ordered:
        """Return the order of a request; a job without a name takes the cycle's."""
        job = request.job.model_copy(update={"job_id": request.job.job_id or cycle_id})
        return cls(verb, request.model_copy(update={"job": job}), cycle_id, Withdrawal(job.deadline_s))


class JobQueue:
    """The waiting jobs, first come first served. Only the machine's owner thread changes it.

    Args:
        most: longest queue.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._waiting: deque[Ordered] = deque()

    @property
    def ids(self) -> tuple[str, ...]:
        """The ids of those that wait, the next one first."""
        return tuple(one.job.job_id for one in tuple(self._waiting))

    def put(self, ordered: Ordered) -> int:
        """Append a job; return its position, from 1 on. Raises: Refused (QUEUE_FULL)."""
        if len(self._waiting) >= self._most:
            raise Refused(
                f"{len(self._waiting)} jobs wait, and no more may (queue.max).",
                "Wait until one begins, or cancel one.",
                code="QUEUE_FULL",
            )
        self._waiting.append(ordered)
        return len(self._waiting)

    def put_next(self, ordered: Ordered) -> int:
        """Let a job begin as soon as the cell is ready, which is at once; return its position, 0."""
        self._waiting.appendleft(ordered)
        return 0

    def take(self) -> Ordered | None:
        """Remove and return the next job; None for none."""
        return self._waiting.popleft() if self._waiting else None

    def remove(self, job_id: str) -> bool:
        """Remove one job by its id. Returns: whether it waited."""
        kept = [one for one in self._waiting if one.job.job_id != job_id]
        was_there = len(kept) < len(self._waiting)
        self._waiting = deque(kept)
        return was_there

    def drop(self) -> tuple[str, ...]:
        """Remove every job; return their ids."""
        dropped = self.ids
        self._waiting.clear()
        return dropped
