"""How `benchmarks soak` tells a process that grows from one that is now and then larger."""

from __future__ import annotations

import mmap
import os

from benchmarks.growth import Growth


def test_a_process_that_stays_as_it_is_has_not_grown() -> None:
    growth = Growth()
    for _ in range(60):
        growth.look(os.getpid(), None)
    assert growth.daemon.worst_rss_mb() < 1.0
    assert growth.daemon.worst_fds() == 0
    assert growth.node.worst_rss_mb() == 0.0


def test_memory_and_files_that_are_kept_are_growth() -> None:
    growth = Growth()
    kept: list[mmap.mmap] = []  # pages of their own: the heap of a long test run has room
    files: list[int] = []
    for number in range(60):
        growth.look(os.getpid(), None)
        if number >= 40:
            kept.append(mmap.mmap(-1, 1_000_000))
            kept[-1].write(os.urandom(1_000_000))
            files.append(os.dup(2))
    for file in files:
        os.close(file)
    assert growth.daemon.worst_rss_mb() > 5.0
    assert growth.daemon.worst_fds() > 5
