"""The gate every motion of arm and hand passes: shut while held, and for good once halted."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from bus.cancel import Cancel
from bus.errors import CycleFailure


class Gate:
    """Every member may be called from any thread."""

    def __init__(self) -> None:
        self._change = threading.Condition()
        self._held = False
        self._cancel = Cancel()
        self._cause: CycleFailure | None = None
        self._passed = 0

    def halt(self, cause: CycleFailure | None = None) -> None:
        """Let nothing through any more, and turn away whoever waits; ``cause``: what failed, if no command it was."""
        with self._change:
            self._cancel.set()
            self._cause = self._cause or cause
            self._change.notify_all()

    def hold(self) -> None:
        """Let nothing begin until `release`: whoever comes waits."""
        with self._change:
            self._held = True

    def release(self) -> None:
        """End a hold; after a halt that changes nothing."""
        with self._change:
            self._held = False
            self._change.notify_all()

    def clear(self) -> None:
        """Open again, after a halt or a hold."""
        with self._change:
            self._held = False
            self._cancel = Cancel()  # what a halt left behind keeps the old one, and stays stopped
            self._cause = None
            self._change.notify_all()

    @property
    def cause(self) -> CycleFailure | None:
        """What failed, first, since the gate was last opened; None when it was halted by command or not at all."""
        return self._cause

    @property
    def halted(self) -> bool:
        """Whether somebody asked the cell to stop."""
        return self._cancel.is_set

    @property
    def held(self) -> bool:
        """Whether nothing may begin until `release`."""
        return self._held

    @property
    def cancel(self) -> Cancel:
        """For whatever computes between motions: set by the halt that turns these away."""
        return self._cancel

    @property
    def is_moving(self) -> bool:
        """Whether a motion was let through that is not over: under way, on its way to its device, or held by it."""
        return self._passed > 0

    @contextmanager
    def motion(self) -> Iterator[bool]:
        """Around every motion: waits while held, then says whether it may begin; False once halted."""
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
        """Wait until no motion is under way; False when one still is."""
        with self._change:
            return self._change.wait_for(lambda: self._passed == 0, timeout_s)
