"""CPU starvation of this process: the time that its threads wait for a core, as the kernel counts it.

The lateness of a timer is no measure of it: the scheduler prefers a thread that has slept. Beside 12 busy loops on two
cores a timer of 50 ms was 8 ms late in the mean, while 1 s of computing took 20 s or more.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

_THREADS, _LOAD = Path("/proc/self/task"), Path("/proc/loadavg")
_KEPT = 0.5
"""Weight of all earlier measurements together."""
_UNDISTURBED_S = 0.005
"""Added to the running time [s]: the waits of a process that hardly runs say little."""
_BUSY_LOAD, _BUSY_SLOWDOWN = 1.5, 3.0
"""Load per core and slowdown of a machine that is too busy. A cell alone on two cores has a slowdown of up to 2."""

Counts = Mapping[str, tuple[float, float]]
"""Running time of each thread, and its time in the run queue without a core, since it began [s]."""


class Starvation(NamedTuple):
    """Load of the machine and slowdown of this process.

    Attributes:
        slowdown: wall time for the work that takes 1 s when every thread has a core at once; at least 1.
        load: runnable threads of the whole machine.
        cores: of the whole machine.
    """

    slowdown: float
    load: float
    cores: int

    def in_words(self) -> str:
        """Return a sentence when the machine is too busy, else ""."""
        if self.slowdown <= _BUSY_SLOWDOWN and self.load <= _BUSY_LOAD * self.cores:
            return ""
        slower = f", and a second of work takes {self.slowdown:.0f} s" if self.slowdown > _BUSY_SLOWDOWN else ""
        return f"This machine is too busy: load {self.load:.1f} on {self.cores} cores{slower}."


def load_now() -> Starvation:
    """Return the load of this machine, averaged over 1 min; the slowdown is not measured."""
    return Starvation(1.0, os.getloadavg()[0], _cores())


class StarvationMeter:
    """Measures the starvation between two calls; earlier measurements fade.

    Args:
        threads: returns the counts of this process.
        runnable: returns the number of runnable threads of this machine.
        cores: of this machine; None = as the operating system says.
    """

    def __init__(
        self,
        threads: Callable[[], Counts] = lambda: counts_of(_THREADS),
        runnable: Callable[[], float] = lambda: _runnable(),
        cores: int | None = None,
    ) -> None:
        self._threads, self._runnable, self._cores = threads, runnable, cores or _cores()
        self._before = threads()
        self._ran_s = self._waited_s = 0.0
        self._load = runnable()

    def measure(self) -> Starvation:
        """Return the starvation since the last call. Takes 0.6 ms for 50 threads."""
        before, now = self._before, self._threads()
        self._before = now
        self._ran_s, self._waited_s = _KEPT * self._ran_s, _KEPT * self._waited_s
        for thread, (ran_s, waited_s) in now.items():
            ran_before_s, waited_before_s = before.get(thread, (0.0, 0.0))
            if ran_s >= ran_before_s:  # else it is another thread of the same number
                self._ran_s += ran_s - ran_before_s
                self._waited_s += waited_s - waited_before_s
        self._load = _KEPT * self._load + (1.0 - _KEPT) * self._runnable()
        ran_s = self._ran_s + _UNDISTURBED_S
        slowdown = max(1.0, (ran_s + self._waited_s) / ran_s, self._load / self._cores)
        return Starvation(slowdown, self._load, self._cores)


def counts_of(tasks: Path) -> Counts:
    """Read the counts of every thread in a process's folder ``task``; none where the kernel does not count."""
    counts: dict[str, tuple[float, float]] = {}
    with suppress(OSError):
        for thread in os.listdir(tasks):
            with suppress(OSError):  # the thread has just ended
                ran_ns, waited_ns, _ = (tasks / thread / "schedstat").read_bytes().split()
                counts[thread] = int(ran_ns) / 1e9, int(waited_ns) / 1e9
    return counts


def _runnable() -> float:
    """Read the number of runnable threads; 0 where the kernel does not give it."""
    try:
        return float(_LOAD.read_text().split()[3].partition("/")[0])
    except (OSError, IndexError, ValueError):
        return 0.0


def _cores() -> int:
    """Return the number of this machine's cores: its load is of all of them, whichever this process may use."""
    return os.cpu_count() or 1
