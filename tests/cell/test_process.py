"""A process that runs for long: its garbage collector has little to look through, its threads share their heaps."""

from __future__ import annotations

import gc
import subprocess
import sys

import pytest

from cell.nodes.process import freeze_gc

_THREADS = """
import ctypes, threading
from cell.nodes.process import limit_malloc_arenas
limit_malloc_arenas()
done = threading.Barrier(9)
def allocate():
    ctypes.CDLL(None).malloc(100_000)
    done.wait()
for _ in range(8):
    threading.Thread(target=allocate).start()
done.wait()
ctypes.CDLL(None).malloc_stats()
"""


def test_what_was_there_before_is_not_looked_through_until_the_end() -> None:
    with pytest.raises(KeyError), freeze_gc():
        assert gc.get_freeze_count() > 10_000
        raise KeyError
    assert gc.get_freeze_count() == 0


@pytest.mark.skipif(sys.platform != "linux", reason="arenas are glibc's")
def test_eight_threads_share_two_heaps() -> None:
    done = subprocess.run([sys.executable, "-c", _THREADS], capture_output=True, text=True, check=True)
    arenas = [line for line in done.stderr.splitlines() if line.startswith("Arena")]
    assert 1 <= len(arenas) <= 2, done.stderr
