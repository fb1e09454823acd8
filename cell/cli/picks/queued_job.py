"""A job that waits in the cell's queue, as the client that waits for it sees it."""

from __future__ import annotations

from collections.abc import Callable

from bus.commands import CellState, CommandReply
from cell.machine.states import SETTLED
from cell.outcome import Asked, dropped, is_known


class QueuedJob:
    """Notices that a job left the queue without beginning: no result will ever come of it.

    The client has the lease since it asked: if it went at once, the cell would hold the pick under way.

    Args:
        cell: who is asked. ``reply``: to the command; a job that begins at once is never taken for dropped.
        tell: called with a line for a person, once, when the job is dropped and something else moves.
    """

    def __init__(self, cell: Asked, reply: CommandReply, tell: Callable[[str], None]) -> None:
        self._cell, self._job_id, self._tell = cell, reply.job_id, tell
        self._waits, self._was_seen, self._is_dropped = reply.position > 0, False, False

    def hear(self, state: CellState) -> None:
        """Process a state of the cell. Raises: Refused (JOB_DROPPED) as soon as nothing moves, BusError."""
        if not self._waits:
            return
        if self._job_id in state.queue:
            self._was_seen = True
        elif self._job_id == state.job_id:
            self._waits = False
        elif self._was_seen and not self._is_dropped:
            self._is_dropped = not is_known(self._cell.state(), self._job_id)  # it may begin between two states
            if self._is_dropped and not _is_at_rest(state):
                self._tell(f"job {self._job_id} will not begin; what moves is attended from here; Ctrl-C holds it")
        if self._is_dropped and _is_at_rest(state):
            raise dropped(self._job_id)


def _is_at_rest(state: CellState) -> bool:
    """Return whether nothing moves, and no pick of a job follows."""
    return state.state in SETTLED and not state.job_id
