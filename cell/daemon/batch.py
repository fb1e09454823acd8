"""The picks of one ``start``: a number of them, or until the table is empty; and when to give up."""

from __future__ import annotations

from bus.codes import Code
from bus.commands import CommandRequest
from bus.frozen import Message
from bus.messages import CycleResult
from config.pick import RetrySettings

MAX_FAILED_IN_A_ROW, MAX_UNTOUCHED_IN_A_ROW = 3, 2
"""Limits of consecutive failures in picks until empty, and of those that touched nothing: the next pick would fail the
same way."""

IN_THE_SCENE = frozenset({Code.NO_GRASP, Code.NOT_SEEN, Code.NO_DEPTH, Code.TOO_NEAR, Code.COLLISION, Code.UNREACHABLE})
"""Failures before any motion that lie in what stands there, all of it, from every look: another pick finds the same
scene, and differs only by the noise of the camera."""

_NO_HOLD = RetrySettings()


class Summary(Message):
    """The end of a batch until empty.

    Attributes:
        picked, failed: picks that ended in SUCCESS, and in FAILED or ABORTED; all attempts of a pick count as one.
        objects_left: objects really in the pick region; None = unknown (on hardware, or without the node).
        is_empty: the last pick found no further object.
        reason: why the batch ended.
    """

    picked: int
    failed: int
    objects_left: int | None
    is_empty: bool
    reason: str

    def line(self) -> str:
        """One line for a person."""
        left = "unknown" if self.objects_left is None else str(self.objects_left)
        return f"picked {self.picked}, failed {self.failed}, objects left: {left}. {self.reason}"


class Batch:
    """Counts results, and decides whether another pick follows.

    Args:
        retry: with ``hold_after`` the cell holds, where a batch until empty would otherwise give up.

    Attributes:
        picked, failed: as in `Summary`. ``done``: number of counted picks.
        is_over: no further pick follows. ``is_empty``: because the last one found no object.
        reason: why it is over, "" before that.
        gave_up: it is over because too many failed in a row.
    """

    def __init__(self, request: CommandRequest, retry: RetrySettings = _NO_HOLD) -> None:
        self._gives_up = retry.hold_after == 0  # otherwise the cell holds instead
        self._cycles = None if request.until_empty else request.cycles
        self._failed_in_a_row = self._untouched_in_a_row = 0
        self.picked = self.failed = self.done = 0
        self.is_over = self.is_empty = self.gave_up = False
        self.reason = ""

    @property
    def is_followed(self) -> bool:
        """Whether another pick is to follow the one under way."""
        return not self.is_over and (self._cycles is None or self.done + 1 < self._cycles)

    def hear(self, result: CycleResult) -> None:
        """Count one result; an empty table or a fault ends every batch. A result that is retried does not count."""
        if result.retried_as:
            return
        self.done += 1
        self.picked += result.result == "SUCCESS"
        failed = result.result in ("FAILED", "ABORTED")
        self.failed += failed
        self._failed_in_a_row = self._failed_in_a_row + 1 if failed else 0
        self._untouched_in_a_row = self._untouched_in_a_row + 1 if failed and result.code in IN_THE_SCENE else 0
        why = f"{result.code or ''}: {result.reason}"
        if result.result == "EMPTY":
            self.is_empty = True
            self.end(result.reason)
        elif result.result == "ABORTED":
            self.end(f"Aborted by {why}")
        elif result.code in (Code.CANCELLED, Code.DEADLINE, Code.APPROVAL_TIMEOUT):
            self.end(f"The job ends: {why}")
        elif self._cycles is None and result.code is Code.LEFT_OVER:
            self.end(result.reason)
        elif self._cycles is None and self._gives_up and self._has_failed_too_often():
            self.gave_up = True
            self.end(f"{self._failed_in_a_row} picks in a row failed, the last by {why}")
        elif self.done == self._cycles:
            self.end("All picks are done.")

    def _has_failed_too_often(self) -> bool:
        return self._failed_in_a_row == MAX_FAILED_IN_A_ROW or self._untouched_in_a_row == MAX_UNTOUCHED_IN_A_ROW

    def end(self, reason: str) -> None:
        """End the batch: no further pick follows. The first reason is kept."""
        if not self.is_over:
            self.is_over, self.reason = True, reason

    def summary(self, objects_left: int | None) -> Summary:
        """Return the summary of the batch; ``objects_left``: None = unknown."""
        return Summary(
            picked=self.picked,
            failed=self.failed,
            objects_left=objects_left,
            is_empty=self.is_empty,
            reason=self.reason,
        )
