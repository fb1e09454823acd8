"""Watches the hand while the arm carries: its states, read again and again in a thread of their own."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from bus.errors import BusError, DriverError
from bus.messages import HandState
from bus.threads import OwnedThread, Role

_PERIOD_S = 0.05
"""The hand's own states are published as often."""


@contextmanager
def watched(read: Callable[[], HandState]) -> Iterator[list[HandState]]:
    """While the block runs, ``read`` the hand into the list that is yielded.

    Raises: at the end of the block, what reading raised: DriverError, BusError.
    """
    states: list[HandState] = []
    failures: list[DriverError | BusError] = []
    is_over = threading.Event()

    def watch() -> None:
        try:
            states.append(read())
            while not is_over.wait(_PERIOD_S):
                states.append(read())
        except (DriverError, BusError) as error:
            failures.append(error)

    thread = OwnedThread(Role.HAND, watch, of="watch").start()
    try:
        yield states
    finally:
        is_over.set()
        thread.join()
    if failures:
        raise failures[0]
