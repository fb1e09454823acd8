"""A call on a thread of its own: whoever asked may stop waiting, and how it ends is told all the same."""

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
    """Nobody waits for the call any more: there was a stop, or its time is over."""


class Call(Generic[ResultT]):
    """Runs ``work`` until it ends, whoever waits.

    Args:
        late: told on its thread how it ended when nobody waited any more: its result, or what it raised.
        of: what is called, for the thread's name.
    """

    def __init__(self, work: Callable[[], ResultT], late: Callable[[ResultT | BaseException], None], of: str) -> None:
        self._work, self._late = work, late
        self._outcome: queue.SimpleQueue[ResultT | BaseException] = queue.SimpleQueue()
        self._turn = threading.Lock()
        self._is_given_up = False
        self._thread = OwnedThread(Role.MODEL_CALL, self._run, of=of).start()

    def wait(self, timeout_s: float, cancel: Cancel) -> ResultT:
        """Its result. Raises: GivenUp, after a stop or the time; or what the work raised."""
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

    @property
    def is_over(self) -> bool:
        return not self._thread.is_alive()

    def _run(self) -> None:
        outcome: ResultT | BaseException
        try:
            outcome = self._work()
        except BaseException as error:  # noqa: BLE001 - handed over to whoever waits, who raises it
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
