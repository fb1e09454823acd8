"""The page of the day, kept up to date while the cell runs."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from bus.errors import RecordingError
from cell.terminal.printing import err
from logs.report.day_report import write_day

_SHARE = 0.02
"""Most of the time that the page may take: that of a day of thousands is written less often than after each cycle."""


class DayPage:
    """Writes the page of a day's folder between cycles.

    Args:
        write: writes it, and raises RecordingError. ``clock_s``: any steady clock [s].
    """

    def __init__(
        self, write: Callable[[Path], Path] = write_day, clock_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._write, self._clock_s = write, clock_s
        self._stale: Path | None = None
        self._rests_until_s = -float("inf")

    def written(self, recording: Path) -> None:
        """Note that the page of a cycle was written; write that of a day that has ended since at once."""
        if self._stale not in (None, recording.parent):
            self._bring_up_to_date()
        self._stale = recording.parent

    def turn(self) -> None:
        """There is time for it; what fails is told, and tried again after the next cycle."""
        if self._stale is not None and self._clock_s() >= self._rests_until_s:
            self._bring_up_to_date()

    def close(self) -> None:
        """Nothing more is written."""
        if self._stale is not None:
            self._bring_up_to_date()

    def _bring_up_to_date(self) -> None:
        assert self._stale is not None
        began_s = self._clock_s()
        try:
            self._write(self._stale)
        except RecordingError as error:
            err.line(f"{error.code}: {error}")
        self._stale = None
        self._rests_until_s = self._clock_s() + (self._clock_s() - began_s) / _SHARE
