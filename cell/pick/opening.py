"""Opens the hand while the arm moves: on its way home, and on its way to an object.

To an object the arm goes on only once the hand is open: it waits by itself before its approach line
(`Trajectory.waits_at`), so that whatever is lost - the hand, or this process - it never goes down with fingers that are
not open. `Arm.resume` lets it go on. So does the end of a hold; that is confirmed only when the fingers are open or the
arm was stopped for good: until then two motions are under way (see `cell.machine.standstill`).
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from bus.errors import BusError, DriverError, MotionRefused
from bus.messages import ArmMode, HandState
from bus.threads import OwnedThread, Role
from cell.machine.gate import Gate
from drivers.interface import Arm

_log = logging.getLogger(__name__)
_LOOK_S = 0.005


class Opening:
    """The hand on its way to its opening, in a thread of its own; every motion passes the gate.

    Args:
        open_hand: opens it, and checks that it is open; None when it was stopped. Raises: DriverError, BusError.
    """

    def __init__(self, arm: Arm, gate: Gate, open_hand: Callable[[], HandState | None]) -> None:
        self._arm, self._gate, self._open_hand = arm, gate, open_hand
        self._asked, self._is_over = threading.Event(), threading.Event()
        self._begins = False
        self._failure: DriverError | BusError | None = None
        self._state: HandState | None = None
        self._thread = OwnedThread(Role.HAND, self._run, of="opening")

    def begin(self) -> bool:
        """Start the fingers, once the gate lets them; False when it does not. Only then may the arm begin."""
        self._thread.start()
        self._asked.wait()
        return self._begins

    def wait(self) -> None:
        """Wait for the fingers, once the arm rests."""
        self._is_over.set()
        self._thread.join()

    def require_open(self) -> HandState | None:
        """Return the fingers' state, None when they were stopped. Raises: what went wrong with them."""
        if self._failure is not None:
            raise self._failure
        return self._state

    def _run(self) -> None:
        try:
            with self._gate.motion() as self._begins:
                self._asked.set()
                if self._begins:
                    self._open_or_stop()
        finally:
            self._asked.set()
        if self._state is not None:
            with self._gate.motion() as may_go_on:
                if may_go_on:
                    self._let_go_on()

    def _open_or_stop(self) -> None:
        """Open the hand; when that fails the arm stops for good."""
        try:
            self._state = self._open_hand()
        except (DriverError, BusError) as error:
            self._failure = error
            self._stop_arm()

    def _stop_arm(self) -> None:
        """Stop it for good: when it has just been asked to move, as soon as it does."""
        try:
            self._when_under_way(self._arm.stop)
        except (DriverError, BusError) as error:
            _log.error("the arm does not say whether it moves: %s", error)
            self._arm.stop()

    def _let_go_on(self) -> None:
        try:
            self._when_under_way(self._arm.resume)
        except MotionRefused:  # the end of a hold has let it go on
            return
        except (DriverError, BusError) as error:
            self._failure = error
            self._stop_arm()

    def _when_under_way(self, act: Callable[[], None]) -> None:
        """Do it as soon as the arm moves or waits; not at all when its motion is over."""
        while not self._is_over.is_set():
            if self._arm.state().mode is ArmMode.MOVE:
                act()
                return
            self._is_over.wait(_LOOK_S)


@contextmanager
def opened_meanwhile(gate: Gate, open_hand: Callable[[], HandState | None]) -> Iterator[None]:
    """While the block moves the arm, open the hand, which nothing waits for; its motion passes the gate.

    Raises: at the end of the block, what went wrong with the hand: DriverError, BusError.
    """
    failures: list[DriverError | BusError] = []

    def work() -> None:
        try:
            with gate.motion() as may_begin:
                if may_begin:
                    open_hand()
        except (DriverError, BusError) as error:
            failures.append(error)

    thread = OwnedThread(Role.HAND, work, of="opening").start()
    try:
        yield
    finally:
        thread.join()
    if failures:
        raise failures[0]
