"""A stop signal that is passed down to long computations, which check it between their steps."""

from __future__ import annotations

import threading
from collections.abc import Callable

from bus.codes import Code
from bus.errors import CycleFailure


class Cancel:
    """One stop signal of one piece of work. Any thread may set or read it; once set it stays set.

    Args:
        others: further reasons to stop, asked whenever the signal is read.
    """

    def __init__(self, *others: Callable[[], bool]) -> None:
        self._event, self._others = threading.Event(), others

    def set(self) -> None:
        """Stop the work."""
        self._event.set()

    @property
    def is_set(self) -> bool:
        """Whether the stop was given."""
        return self._event.is_set() or any(other() for other in self._others)

    def wait(self, timeout_s: float) -> bool:
        """Wait for `set`, at most ``timeout_s``. Returns whether it was given."""
        return self._event.wait(timeout_s) or self.is_set

    def raise_if_set(self, during: str) -> None:
        """Raises: CycleFailure(STOPPED) after `set`; ``during`` names the work, e.g. ``detect``."""
        if self.is_set:
            raise CycleFailure(Code.STOPPED, f"Stopped during {during!r}.")
