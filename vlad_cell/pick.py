"""A pick that was begun on a running cell."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

from bus.errors import ReplyTimeout
from bus.messages import CycleResult
from cell.client import Client
from cell.following import Following, Said
from vlad_cell.said import attended, in_words

Progress = Callable[[str], object]
"""Called with a line for a person, as ``print``."""


class Pick:
    """A pick that was begun. Iterate over it to hear what happens, or `wait` for its result.

    Attributes:
        cycle_id: of the cycle that began, or will; a retry is a cycle of its own.
        job_id: of the job. ``position``: in the queue, from 1 on; 0 = it begins now.
        result: of its last attempt; None before the end.
    """

    cycle_id: str
    job_id: str
    position: int
    result: CycleResult | None

    def __init__(self, client: Client, cycle_id: str, job_id: str, position: int) -> None:
        self._client, self._following = client, Following(client, cycle_id, job_id)
        self.cycle_id, self.job_id, self.position = cycle_id, job_id, position
        self.result = None

    def __repr__(self) -> str:
        if self.result is not None:
            return f"Pick {self.cycle_id}, {' '.join(filter(None, (self.result.result, self.result.code)))}"
        return f"Pick {self.cycle_id}, {f'number {self.position} in the queue' if self.position else 'begun'}"

    def __iter__(self) -> Iterator[Said]:
        """Yield what the cell says, until the result is there, which is the last.

        Raises: CellUnreachable when the cell is gone; Refused (JOB_DROPPED) when the job was dropped before it began.
        """
        return (said for said in self._turns() if said is not None)

    def _turns(self) -> Iterator[Said | None]:
        """As iterated over, and None several times a second while nothing is said."""
        for said in self._following:
            self.result = self._following.result
            yield said

    def wait(self, timeout_s: float = 600.0, progress: Progress | None = None) -> CycleResult:
        """Wait for the result of the last attempt; the arguments and errors are those of `Cell.pick`."""
        with attended(self._client):
            return self._wait(time.monotonic() + timeout_s, progress)

    def _wait(self, give_up_s: float, progress: Progress | None) -> CycleResult:
        before = ""
        for said in self._turns():
            line = in_words(said) if said is not None else ""
            if progress is not None and line and line != before:  # a state is told again with its cycle
                progress(line)
            before = line or before
            if time.monotonic() > give_up_s and self.result is None:
                raise ReplyTimeout(f"Cycle {self.cycle_id} has given no result in time.", "See `cell status`.")
        assert self.result is not None, "the iteration ends with it"
        return self.result
