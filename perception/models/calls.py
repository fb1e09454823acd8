"""A call on its own thread: the caller may stop waiting, and the outcome is still reported."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

from bus.cancel import Cancel
from bus.threads import OwnedThread, Role

ResultT = TypeVar("ResultT")
_LOOK_S = 0.02


class GivenUp(Exception):
    """The caller no longer waits for the call: a stop came, or the time is over."""


class Call(Generic[ResultT]):
    """Runs ``work`` to its end, even when the caller no longer waits.

    Args:
        late: called on the call's thread with its result or exception, if the caller gave up before.
        of: what is called, for the thread's name.
    """

    def __init__(self, work: Callable[[], ResultT], late: Callable[[ResultT | BaseException], None], of: str) -> None:
        self._work, self._late = work, late
        self._outcome: queue.SimpleQueue[ResultT | BaseException] = queue.SimpleQueue()
        self._turn = threading.Lock()
        self._is_given_up = False
        self._thread = OwnedThread(Role.MODEL_CALL, self._run, of=of).start()

    def wait(self, timeout_s: float, cancel: Cancel) -> ResultT:
        """Return the call's result within ``timeout_s``. Raises: GivenUp after that or a stop; or as ``work``."""
        end_s = time.monotonic() + timeout_s
        while (left_s := end_s - time.monotonic()) > 0 and not cancel.is_set:
            try:
                return _result(self._outcome.get(timeout=min(left_s, _LOOK_S)))
            except queue.Empty:
                continue
        with self._turn:
            if self._outcome.empty():
                self._is_given_up = True
                raise GivenUp
        return _result(self._outcome.get())

    def lasts(self, seconds: float) -> bool:
        """Wait for the end of ``work``, for so long at most; True when it has not ended then."""
        self._thread.join(seconds)
        return not self.is_over

    @property
    def is_over(self) -> bool:
        """True when ``work`` has ended."""
        return not self._thread.is_alive()

    def _run(self) -> None:
        outcome: ResultT | BaseException
        try:
            outcome = self._work()
        except BaseException as error:  # noqa: BLE001 - handed to the waiting caller, which raises it
            outcome = error
        with self._turn:
            if not self._is_given_up:
                self._outcome.put(outcome)
                return
        self._late(outcome)


def _result(outcome: ResultT | BaseException) -> ResultT:
    if isinstance(outcome, BaseException):
        raise outcome
    return outcome
