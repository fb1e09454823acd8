"""Growth of memory and open files of a cell's processes.

The size of a working process varies with its uncollected garbage. Its growth is the median of its last samples minus
the median of the first ones after its warm-up.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

_WARM_UP = 20
_WINDOW = 20


@dataclass
class Grown:
    """Of every process of a kind, by its id: memory [MB] and open files more than after its warm-up."""

    rss_mb: dict[int, float] = field(default_factory=dict)
    fds: dict[int, float] = field(default_factory=dict)

    def worst_rss_mb(self) -> float:
        """Of the process that has grown most."""
        return round(max(self.rss_mb.values(), default=0.0), 1)

    def worst_fds(self) -> int:
        """Of the process that has grown most."""
        return round(max(self.fds.values(), default=0))


@dataclass
class Growth:
    """Of the daemon alone, and of its node, however often they were started anew."""

    daemon: Grown = field(default_factory=Grown)
    node: Grown = field(default_factory=Grown)
    _looks: dict[int, list[tuple[float, int]]] = field(default_factory=dict)

    def look(self, daemon: int, node: int | None) -> None:
        """At two processes by their ids, to be called while the cell is Idle."""
        self._look(self.daemon, daemon)
        if node is not None:
            self._look(self.node, node)

    def _look(self, grown: Grown, pid: int) -> None:
        looks = self._looks.setdefault(pid, [])
        looks.append((_rss_mb(pid), len(os.listdir(f"/proc/{pid}/fd"))))
        warm = looks[_WARM_UP:]
        window = min(_WINDOW, len(warm) // 2)
        if window == 0:
            return
        for by_pid, column in ((grown.rss_mb, 0), (grown.fds, 1)):
            first, last = (median(look[column] for look in part) for part in (warm[:window], warm[-window:]))
            by_pid[pid] = last - first


def _rss_mb(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
