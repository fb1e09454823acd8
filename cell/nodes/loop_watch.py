"""Ends the process of a door whose event loop stands still: no client's end is noticed, no lease is given back."""

from __future__ import annotations

import asyncio
import logging
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from bus.clock import DeadlineClock
from bus.silence import Silence
from bus.threads import OwnedThread, Role, handled_by

LOOK_S, STALLED_S = 0.25, 5.0
_DEFECT_EXIT_CODE = 70


class LoopWatch:
    """Watches the running event loop, from its construction to `close`, on a thread of its own.

    Time in which the whole process stood still does not count: its loop did not hang.

    Args:
        of: the door, for the thread's name.
        stalled_s: a loop that stands still for so long is a defect of the thread.
    """

    def __init__(self, clock: DeadlineClock, of: str, stalled_s: float = STALLED_S) -> None:
        self._silence = Silence(stalled_s, LOOK_S, clock.now_s)
        self._stalled_s, self._closing = stalled_s, threading.Event()
        self._turning = asyncio.create_task(self._turn())
        self._thread = OwnedThread(Role.DOOR, self._watch, of=f"{of}-loop").start()

    def close(self) -> None:
        """Watch no longer. Idempotent; called on the loop."""
        self._closing.set()
        self._turning.cancel()
        self._thread.join()

    async def _turn(self) -> None:
        while True:
            self._silence.hear()
            await asyncio.sleep(LOOK_S)

    def _watch(self) -> None:
        while not self._closing.wait(LOOK_S):
            if self._silence.is_broken():
                raise RuntimeError(f"the loop stands still for more than {self._stalled_s:.0f} s")


@contextmanager
def ended_by_defect() -> Iterator[None]:
    """Within it a defect of an owned thread ends this process: its leases end with it, and it is started again."""
    with handled_by(_end):
        yield


def _end(_name: str, _defect: BaseException) -> None:
    logging.shutdown()
    os._exit(_DEFECT_EXIT_CODE)
