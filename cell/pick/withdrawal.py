"""The end of a job before its grasp: its client cancels it, or its time is over. After that neither counts.

A stop is another matter: it ends everything, at any time (`cell.machine.gate`).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from bus.codes import Code
from bus.errors import CycleFailure


class Withdrawal:
    """Whether one job is withdrawn. Any thread may ask.

    Args:
        deadline_s: time from now, after which the job is late; None = never.
        now_s: a clock that only goes forward.
    """

    def __init__(self, deadline_s: float | None = None, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s, self._deadline_s = now_s, deadline_s
        self._late_s = None if deadline_s is None else now_s() + deadline_s
        self._turn = threading.Lock()
        self._is_cancelled = self._is_grasping = False

    def cancel(self) -> bool:
        """Withdraw the job. Returns: False when a grasp of it is under way, which is not undone."""
        with self._turn:
            self._is_cancelled = True
            return not self._is_grasping

    def begin_cycle(self) -> None:
        """A further cycle of the job begins: until its grasp it can be withdrawn."""
        with self._turn:
            self._is_grasping = False

    def begin_grasp(self) -> None:
        """Note that the arm goes to the grasp. Raises: CycleFailure (CANCELLED, DEADLINE) of a withdrawn job."""
        with self._turn:
            due = self.due()
            if due is not None:
                raise due
            self._is_grasping = True

    def due(self) -> CycleFailure | None:
        """Return why the job must not go on; None when it may."""
        if self._is_cancelled:
            return CycleFailure(Code.CANCELLED, "The job was cancelled.")
        if self._late_s is not None and self._now_s() > self._late_s:
            return CycleFailure(Code.DEADLINE, f"The job's {self._deadline_s:g} s were over before its grasp.")
        return None
