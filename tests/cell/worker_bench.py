"""Work for the tests of workers; a module of its own, because every worker imports it."""

from __future__ import annotations

import os
import signal
from pathlib import Path


def squared(number: int) -> int:
    """Work that is done."""
    return number**2


def deadly(number: int, marks: Path) -> int:
    """Work whose process is killed at its first try of item 0, and at each of item 2."""
    mark = marks / str(number)
    if number == 2 or (number == 0 and not mark.exists()):
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return squared(number)


def fails(number: int) -> int:
    """Work with a defect."""
    raise ZeroDivisionError(number)


def on_interrupt(_number: int) -> tuple[bool, bool]:
    """Whether this process has Ctrl-C blocked, and whether it ignores it."""
    return (
        signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ()),
        signal.getsignal(signal.SIGINT) is signal.SIG_IGN,
    )
