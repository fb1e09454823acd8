"""The outcome of a pick: the result of its last attempt, or that its job was dropped before it began."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

from bus.commands import CellState
from bus.errors import Refused
from bus.messages import CycleResult
from cell.machine.states import SETTLED


class Asked(Protocol):
    """A cell that is asked: a `cell.client.Client`, as a rule."""

    def state(self) -> CellState:
        """Return what the cell does now. Raises: BusError."""

    def result(self, cycle_id: str) -> CycleResult | None:
        """Return the result of a cycle; None while there is none. Raises: BusError."""


class Outcome:
    """Asks for what the pick that began as a cycle comes to. Ask it from time to time.

    Args:
        cell: who is asked. ``cycle_id``: of the reply to the command.
        job_id: of that reply, too; "" = not known, and then the job is never taken for dropped.
        grace_s: after a stop the result comes a little later than the rest: so long without one, and the job is
            taken for dropped. 0 = at the second ask.
        now_s: a monotonic clock.

    Attributes:
        cycle_id: of the last attempt that is known.
    """

    cycle_id: str

    def __init__(
        self,
        cell: Asked,
        cycle_id: str,
        job_id: str = "",
        *,
        grace_s: float = 0.0,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._cell, self.cycle_id, self._job_id = cell, cycle_id, job_id
        self._grace_s, self._now_s = grace_s, now_s
        self._over_since_s: float | None = None

    def ask(self) -> CycleResult | None:
        """Return the result of the last attempt; None while there is none. Raises: Refused (JOB_DROPPED), BusError."""
        while (result := self._cell.result(self.cycle_id)) is not None and result.retried_as:
            self.cycle_id = result.retried_as
        if result is not None:
            return result
        if self._over_since_s is not None and self._now_s() - self._over_since_s >= self._grace_s:
            raise dropped(self._job_id)
        if not self._job_id or not is_over(self._cell.state(), self._job_id):
            self._over_since_s = None
        elif self._over_since_s is None:
            self._over_since_s = self._now_s()
        return None


def is_known(state: CellState, job_id: str) -> bool:
    """Return whether the job is under way or waits."""
    return job_id in (state.job_id, *state.queue)


def is_over(state: CellState, job_id: str) -> bool:
    """Return whether nothing moves and the job is not known: its last result is there, or follows at once."""
    return state.state in SETTLED and not is_known(state, job_id)


def dropped(job_id: str) -> Refused:
    """Return the refusal of a job of which no result will ever come."""
    return Refused(
        f"The job {job_id!r} ended without a cycle: it was cancelled, or dropped with a stop.",
        "Make the cell ready, and send it again.",
        code="JOB_DROPPED",
    )
