"""A stop, handed down to whatever computes: long work looks at it between its steps, and ends."""

from __future__ import annotations

import threading

from bus.codes import Code
from bus.errors import CycleFailure


class Cancel:
    """One stop of one piece of work; every thread may look at it. Once set it stays set."""

    def __init__(self) -> None:
        self._event = threading.Event()

    def set(self) -> None:
        """Stop the work."""
        self._event.set()

    @property
    def is_set(self) -> bool:
        return self._event.is_set()

    def wait(self, timeout_s: float) -> bool:
        """Pause for ``timeout_s``, or until the stop comes; whether it came."""
        return self._event.wait(timeout_s)

    def raise_if_set(self, during: str) -> None:
        """Raises: CycleFailure(STOPPED) after `set`; ``during`` names the work, e.g. ``detect``."""
        if self._event.is_set():
            raise CycleFailure(Code.STOPPED, f"Stopped during {during!r}.")
