"""Whether memory and open files of running processes grow."""

from __future__ import annotations

import gc
import os
from pathlib import Path

_WARM_UP = 20


class Growth:
    """Memory and open files of some processes, against what they were after a warm-up."""

    def __init__(self) -> None:
        self._first: dict[int, tuple[int, float, int]] = {}  # looks so far, and the first figures after the warm-up
        self.rss_mb = 0.0
        self.fds = 0

    def look(self, pids: list[int]) -> None:
        """To be called while the cell is Idle."""
        gc.collect()
        for pid in pids:
            looks, rss_mb, fds = self._first.get(pid, (0, 0.0, 0))
            now = _rss_mb(pid), len(os.listdir(f"/proc/{pid}/fd"))
            if looks <= _WARM_UP:
                rss_mb, fds = now
            else:
                self.rss_mb, self.fds = max(self.rss_mb, now[0] - rss_mb), max(self.fds, now[1] - fds)
            self._first[pid] = looks + 1, rss_mb, fds


def _rss_mb(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
