"""The one decision on whether the deadlines of a station are wall time."""

from __future__ import annotations

from functools import cache

from bus.clock import WALL_CLOCK, DeadlineClock, StarvedClock
from config.schema import Station


def clock_of(station: Station) -> DeadlineClock:
    """Return the clock of every deadline of ``station``; one process has one clock.

    Wall time, unless the whole station is simulated on this machine (`Station.is_simulation`): nothing real moves
    there, and a late process was kept waiting by the machine. That holds at real-time pace, too: a simulation that
    cannot keep up falls behind.
    """
    return _starved_clock() if station.is_simulation else WALL_CLOCK


@cache
def _starved_clock() -> StarvedClock:
    return StarvedClock().start()
