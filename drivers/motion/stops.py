"""Counts stops, so that a motion that was requested before a stop does not begin, or ends."""

from __future__ import annotations

import threading
from collections.abc import Callable


class Stops:
    """The stops of one device. A stop is never taken back; a later motion counts from its own request."""

    def __init__(self) -> None:
        self._count = 0
        self._counting = threading.Lock()

    def stop(self) -> None:
        """End every motion requested until now."""
        with self._counting:
            self._count += 1

    def asked(self) -> Callable[[], bool]:
        """Register a motion at its request, before it waits for anything.

        Returns:
            A function that tells whether a stop came since.
        """
        before = self._count
        return lambda: self._count != before
