"""A job that waits in the cell's queue, as the client that waits for it sees it."""

from __future__ import annotations

from typing import Protocol

from bus.commands import CellState, CommandReply
from bus.errors import Refused


class Asked(Protocol):
    """A cell that is asked: a `cell.client.Client`, as a rule."""

    def state(self) -> CellState:
        """Return what the cell does now. Raises: BusError."""


class QueuedJob:
    """Notices that a job left the queue without beginning: no result will ever come of it.

    Args:
        cell: who is asked. ``reply``: to the command; a job that begins at once is never taken for dropped.
    """

    def __init__(self, cell: Asked, reply: CommandReply) -> None:
        self._cell, self._job_id = cell, reply.job_id
        self._waits, self._was_seen = reply.position > 0, False

    def hear(self, state: CellState) -> None:
        """Process a state of the cell. Raises: Refused (JOB_DROPPED), BusError."""
        if not self._waits:
            return
        if self._job_id in state.queue:
            self._was_seen = True
        elif self._job_id == state.job_id:
            self._waits = False
        elif self._was_seen and not self._is_there(self._cell.state()):  # it may begin between two states
            raise Refused(
                f"The job {self._job_id!r} ended without a cycle: it was cancelled, or dropped with a stop.",
                "Make the cell ready, and send it again.",
                code="JOB_DROPPED",
            )

    def _is_there(self, state: CellState) -> bool:
        return self._job_id in (state.job_id, *state.queue)
