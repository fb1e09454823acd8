"""Whether memory and open files of a cell's processes grow."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

_WARM_UP = 20


@dataclass
class Grown:
    """The most that any process of a kind has grown by since its warm-up."""

    rss_mb: float = 0.0
    fds: int = 0


@dataclass
class Growth:
    """Of the daemon alone, and of its node, whatever happened to their processes meanwhile."""

    daemon: Grown = field(default_factory=Grown)
    node: Grown = field(default_factory=Grown)
    _first: dict[int, tuple[int, float, int]] = field(default_factory=dict)  # looks, and figures after the warm-up

    def look(self, daemon: int, node: int | None) -> None:
        """At two processes by their ids, to be called while the cell is Idle."""
        self._look(self.daemon, daemon)
        if node is not None:
            self._look(self.node, node)

    def _look(self, grown: Grown, pid: int) -> None:
        looks, rss_mb, fds = self._first.get(pid, (0, 0.0, 0))
        now = _rss_mb(pid), len(os.listdir(f"/proc/{pid}/fd"))
        if looks <= _WARM_UP:
            rss_mb, fds = now
        else:
            grown.rss_mb, grown.fds = max(grown.rss_mb, now[0] - rss_mb), max(grown.fds, now[1] - fds)
        self._first[pid] = looks + 1, rss_mb, fds


def _rss_mb(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
