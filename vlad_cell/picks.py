"""The picks of one ``start`` on a running cell, heard, or asked for where a message was lost."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

from bus.commands import CellState, CommandReply
from bus.errors import NotReached
from bus.messages import CycleResult
from cell.client import Client
from cell.daemon.batch import Batch
from cell.following import GRACE_S, LOOK_S, Said, next_message
from cell.machine.states import ENDED, told
from cell.outcome import is_over
from vlad_cell.said import attended


class Picks:
    """The results of a batch that a cell has begun, one after the other.

    Args:
        batch: decides whether another result follows. ``reply``: to the command that began it.
        now_s: a monotonic clock.
    """

    def __init__(
        self, client: Client, batch: Batch, reply: CommandReply, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._client, self._batch, self._job_id, self._now_s = client, batch, reply.job_id, now_s
        self._awaited = {reply.cycle_id: None}  # in the order in which they were named
        self._given: set[str] = set()
        self._over_since_s: float | None = None

    def __iter__(self) -> Iterator[CycleResult]:
        """Each result as soon as it is there. Raises: NotReached when the cell ends before the batch; BusError."""
        while not self._batch.is_over:
            with attended(self._client):
                said = next_message(self._client, LOOK_S)
            turn: tuple[Said, ...] = self._asked() if said is None else (said,)
            for one in turn:
                if isinstance(one, CycleResult) and self._is_new(one):
                    yield from self._given_out(one)
                elif isinstance(one, CellState):
                    self._hear_state(one)

    def _given_out(self, result: CycleResult) -> Iterator[CycleResult]:
        """Yield a result. Who leaves the loop before the end attends no motion any more: the cell holds it."""
        try:
            yield result
        except GeneratorExit:
            if not self._batch.is_over:
                self._client.release()
            raise

    def _is_new(self, result: CycleResult) -> bool:
        """Count a result of this batch, once."""
        if result.job.job_id != self._job_id or result.cycle_id in self._given:
            return False
        self._given.add(result.cycle_id)
        if result.retried_as:
            self._awaited[result.retried_as] = None
        self._batch.hear(result)
        return True

    def _hear_state(self, state: CellState) -> None:
        """Note the cycle that a state names. Raises: NotReached when the cell has ended."""
        if state.cycle_id and state.job_id == self._job_id:
            self._awaited[state.cycle_id] = None
        if state.state in ENDED and not self._batch.is_over:
            why = told(state.state, state.reason) or state.state
            raise NotReached(f"After {self._batch.done} of the picks the cell is {why}")

    def _asked(self) -> tuple[Said, ...]:
        """The results that were not heard, then the state. Raises: NotReached when no other pick follows."""
        state = self._client.state()
        results = [self._client.result(one) for one in self._awaited if one not in self._given]
        found = tuple(one for one in results if one is not None)
        if found or not is_over(state, self._job_id):
            self._over_since_s = None
        elif self._over_since_s is None:
            self._over_since_s = self._now_s()
        elif self._now_s() - self._over_since_s >= GRACE_S and state.state not in ENDED:
            raise NotReached(f"The cell ended the job after {self._batch.done} of the picks.", "See `cell cycles`.")
        return (*found, state)
