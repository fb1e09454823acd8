"""Follows a pick on a running cell: what is said of it, heard or asked for, to the result of its last attempt."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from bus import topics
from bus.codec import decode
from bus.commands import CellState, Event
from bus.errors import BadPayload, CellUnreachable
from bus.messages import CycleResult
from bus.sample import Sample
from cell.client import Client
from cell.outcome import Outcome

Said = CellState | Event | CycleResult
"""A state or stage at every change, an event for a person, a cycle's result."""
LOOK_S = 0.5
"""Time without a message after which the cell is asked: one may have been lost."""
GRACE_S = 5.0
"""How much later than the rest of a stopped cell a result may come."""
_KINDS: dict[str, Any] = {topics.STATE.key: CellState, topics.EVENT.key: Event, topics.RESULT.key: CycleResult}


class Following:
    """The pick that began as a cycle. Iterate over it until its result is there.

    Args:
        client: that sent the command. ``cycle_id``, ``job_id``: of the reply.

    Attributes:
        result: of the last attempt; None before the end.
    """

    def __init__(self, client: Client, cycle_id: str, job_id: str) -> None:
        self._client, self._outcome = client, Outcome(client, cycle_id, job_id, grace_s=GRACE_S)
        self.result: CycleResult | None = None

    @property
    def cycle_id(self) -> str:
        """Id of the last attempt that is known."""
        return self._outcome.cycle_id

    def __iter__(self) -> Iterator[Said | None]:
        """Yield what the cell says, None several times a second while it says nothing, and last the result.

        Raises: CellUnreachable when the cell is gone; Refused (JOB_DROPPED) when the job was dropped before it began.
        """
        while self.result is None:
            said = next_message(self._client, LOOK_S)
            if said is None:
                said = self.result = self._outcome.ask()  # a message may have been lost
            elif isinstance(said, CycleResult) and said.cycle_id == self.cycle_id:
                self._hear(said)
            yield said

    def _hear(self, result: CycleResult) -> None:
        if result.retried_as:
            self._outcome.cycle_id = result.retried_as
        else:
            self.result = result


def next_message(client: Client, timeout_s: float) -> Said | None:
    """Return the next state, event or result; None after so long without one. Raises: CellUnreachable."""
    while (sample := client.next_heard(timeout_s)) is not None:
        if (said := _decoded(sample)) is not None:
            return said
    if client.is_gone:
        raise CellUnreachable("The cell is gone: it ended, or the link to it.", "Start it, then see `cell cycles`.")
    return None


def _decoded(sample: Sample) -> Said | None:
    kind: Any = _KINDS.get(sample.key)
    try:
        said: Said | None = decode(kind, sample.payload) if kind is not None else None
    except BadPayload:  # of another version; states and results are asked for anyway
        return None
    return said
