"""The picks of one ``start``: so many, or until the table is empty; and when to give up."""

from __future__ import annotations

from bus.commands import CommandRequest
from bus.frozen import Message
from bus.messages import CycleResult
from config.schema import RetrySettings

MAX_FAILED_IN_A_ROW = 3
"""Of picks until empty: the next one would meet the same."""

_NO_RETRY = RetrySettings()


class Summary(Message):
    """How a batch until empty ended.

    Attributes:
        picked, failed: picks that ended in SUCCESS, and in FAILED or ABORTED, retries and all.
        objects_left: really in the pick region; None where nobody knows (on hardware, or when the node is gone).
        is_empty: whether the last pick found nothing more.
        reason: why it ended.
    """

    picked: int
    failed: int
    objects_left: int | None
    is_empty: bool
    reason: str

    def line(self) -> str:
        """For a person."""
        left = "unknown" if self.objects_left is None else str(self.objects_left)
        return f"picked {self.picked}, failed {self.failed}, objects left: {left}. {self.reason}"


class Batch:
    """Hears every result and knows whether another pick follows.

    Args:
        retry: with ``hold_after`` the cell holds, where a batch until empty would give up.

    Attributes:
        picked, failed: as in `Summary`. ``done``: picks heard of.
        is_over: no other pick follows. ``is_empty``: because the last one found nothing.
        reason: why it is over, "" before that.
        gave_up: it is over because too many failed in a row.
    """

    def __init__(self, request: CommandRequest, retry: RetrySettings = _NO_RETRY) -> None:
        self._gives_up = retry.hold_after == 0  # else the cell holds instead
        self._cycles = None if request.until_empty else request.cycles
        self._failed_in_a_row = 0
        self.picked = self.failed = self.done = 0
        self.is_over = self.is_empty = self.gave_up = False
        self.reason = ""

    def hear(self, result: CycleResult) -> None:
        """Count one result; an empty table or a fault ends every batch. One that is tried again is not yet a pick's."""
        if result.retried_as:
            return
        self.done += 1
        self.picked += result.result == "SUCCESS"
        failed = result.result in ("FAILED", "ABORTED")
        self.failed += failed
        self._failed_in_a_row = self._failed_in_a_row + 1 if failed else 0
        why = f"{result.code or ''}: {result.reason}"
        if result.result == "EMPTY":
            self.is_empty = True
            self.end(result.reason)
        elif result.result == "ABORTED":
            self.end(f"Aborted by {why}")
        elif self._cycles is None and self._gives_up and self._failed_in_a_row == MAX_FAILED_IN_A_ROW:
            self.gave_up = True
            self.end(f"{MAX_FAILED_IN_A_ROW} picks in a row failed, the last by {why}")
        elif self.done == self._cycles:
            self.end("All picks are done.")

    def end(self, reason: str) -> None:
        """No other pick follows; the first reason counts."""
        if not self.is_over:
            self.is_over, self.reason = True, reason

    def summary(self, objects_left: int | None) -> Summary:
        return Summary(
            picked=self.picked,
            failed=self.failed,
            objects_left=objects_left,
            is_empty=self.is_empty,
            reason=self.reason,
        )
