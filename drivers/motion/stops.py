"""Whether a stop came since a motion was asked for: then it does not begin, or ends."""

from __future__ import annotations

import threading
from collections.abc import Callable


class Stops:
    """The stops of one device. None is ever taken back: a later motion counts from when it is asked for itself."""

    def __init__(self) -> None:
        self._count = 0
        self._counting = threading.Lock()

    def stop(self) -> None:
        """End all that was asked for until now."""
        with self._counting:
            self._count += 1

    def asked(self) -> Callable[[], bool]:
        """For a motion that is asked for now, before it waits for anything: whether a stop came since."""
        before = self._count
        return lambda: self._count != before
