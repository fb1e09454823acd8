"""Loops of a node that publish at a fixed rate, and measure whether they keep it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from bus.commands import LoopHealth
from bus.errors import BusError, CellError
from bus.threads import OwnedThread, Role
from drivers.rate import Rate


class Loop:
    """Calls ``act`` every ``period_s`` in a thread of its own, until closed.

    A round that begins a whole period late is a missed deadline and is left out, so that rounds never pile up.

    Args:
        on_fault: called with every error of ``act`` except a closed bus, which ends the loop.
        on_end: called when a closed bus ended the loop.
    """

    def __init__(
        self,
        name: str,
        period_s: float,
        act: Callable[[], None],
        on_fault: Callable[[CellError], None],
        on_end: Callable[[], None] = lambda: None,
    ) -> None:
        self.name = name
        self._period_s, self._act, self._on_fault, self._on_end = period_s, act, on_fault, on_end
        self._rounds = Rate()
        self._missed = 0
        self._fault = ""
        self._changing = threading.Lock()
        self._closing = threading.Event()
        self._thread = OwnedThread(Role.LOOP, self._run, of=name).start()

    def health(self) -> LoopHealth:
        """Return the loop's health; called from another thread, so that a hanging loop shows by its rate."""
        with self._changing:
            rate_hz = self._rounds.hz(time.monotonic())
            return LoopHealth(rate_hz=rate_hz, target_hz=1.0 / self._period_s, missed=self._missed, fault=self._fault)

    def close(self, patience_s: float = 1.0) -> None:
        """End the loop, and wait at most ``patience_s`` for its current round."""
        self._closing.set()
        self._thread.join(patience_s)

    def _run(self) -> None:
        due_s = time.monotonic() + self._period_s
        while not self._closing.wait(max(0.0, due_s - time.monotonic())):
            try:
                self._act()
            except BusError:  # the session is closed
                self._on_end()
                return
            except CellError as error:
                self._fault = f"{error.code}: {error.text}"
                self._on_fault(error)  # the next round tries again
            else:
                self._fault = ""
                self._count()
            due_s += self._period_s
            late = int((time.monotonic() - due_s) / self._period_s)
            if late > 0:
                due_s += late * self._period_s
                with self._changing:
                    self._missed += late

    def _count(self) -> None:
        with self._changing:
            self._rounds.count(time.monotonic())
