"""The gate that every motion of arm and hand passes: closed while held, and permanently once halted."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from bus.cancel import Cancel
from bus.errors import CycleFailure


class Gate:
    """The gate. Every member may be called from any thread."""

    def __init__(self) -> None:
        self._change = threading.Condition()
        self._held = False
        self._cancel = Cancel()
        self._cause: CycleFailure | None = None
        self._passed = 0

    def halt(self, cause: CycleFailure | None = None) -> None:
        """Refuse all motions from now on, including those that wait; ``cause``: the failure, None for a command."""
        with self._change:
            self._cancel.set()
            self._cause = self._cause or cause
            self._change.notify_all()

    def hold(self) -> None:
        """Let no motion begin until `release`; motions wait."""
        with self._change:
            self._held = True

    def release(self) -> None:
        """End a hold; no effect after a halt."""
        with self._change:
            self._held = False
            self._change.notify_all()

    def clear(self) -> None:
        """Open the gate after a halt or a hold."""
        with self._change:
            self._held = False
            self._cancel = Cancel()  # computations of before the halt keep the old one, and stay cancelled
            self._cause = None
            self._change.notify_all()

    @property
    def cause(self) -> CycleFailure | None:
        """The first failure since the gate was last opened; None when it was halted by a command, or not halted."""
        return self._cause

    @property
    def halted(self) -> bool:
        """True when the cell was asked to stop."""
        return self._cancel.is_set

    @property
    def held(self) -> bool:
        """True when no motion may begin until `release`."""
        return self._held

    @property
    def cancel(self) -> Cancel:
        """The cancel flag for computations between motions: set by the halt."""
        return self._cancel

    @property
    def is_moving(self) -> bool:
        """True for a motion that passed and is not over: under way, on its way to its device, or held by it."""
        return self._passed > 0

    @property
    def under_way(self) -> int:
        """Number of motions that passed and are not over."""
        return self._passed

    @contextmanager
    def motion(self) -> Iterator[bool]:
        """Context around every motion: waits while held, then yields True when it may begin, False once halted."""
        with self._change:
            cancel = self._cancel
            self._change.wait_for(lambda: cancel.is_set or not self._held)
            may_begin = not cancel.is_set
            self._passed += may_begin
        try:
            yield may_begin
        finally:
            with self._change:
                self._passed -= may_begin
                self._change.notify_all()

    def wait_still(self, timeout_s: float) -> bool:
        """Wait up to ``timeout_s`` until no motion is under way; False when one still is."""
        with self._change:
            return self._change.wait_for(lambda: self._passed == 0, timeout_s)
