"""The two pipes between a process and its child, and the child's end."""

from __future__ import annotations

import os
import selectors
import subprocess
import sys
from contextlib import suppress
from functools import partial
from typing import IO

from bus.clock import DeadlineClock


def line_within(stream: IO[str], timeout_s: float, clock: DeadlineClock) -> str | None:
    """Return the stream's next line, "" at its end, None after ``timeout_s``."""
    with selectors.DefaultSelector() as selector:
        selector.register(stream, selectors.EVENT_READ)
        return stream.readline() if clock.wait_for(selector.select, timeout_s) else None


def has_ended(child: subprocess.Popen[str], timeout_s: float) -> bool:
    """Wait for the end of ``child``, for ``timeout_s`` at most; True when it has ended."""
    with suppress(subprocess.TimeoutExpired):
        child.wait(timeout_s)
    return child.returncode is not None


def end_child(child: subprocess.Popen[str], timeout_s: float, clock: DeadlineClock) -> bool:
    """End ``child`` by closing its stdin; by force when it has not ended within ``timeout_s``. Idempotent.

    Returns:
        False when it took force.
    """
    if child.stdin is not None and not child.stdin.closed:
        with suppress(BrokenPipeError):
            child.stdin.close()
    if clock.wait_for(partial(has_ended, child), timeout_s):
        return True
    child.kill()
    child.wait()
    return False


def close_pipes(child: subprocess.Popen[str]) -> None:
    """Close both pipes to a child that has ended."""
    for pipe in (child.stdin, child.stdout):
        if pipe is not None:
            with suppress(BrokenPipeError):  # the unwritten rest is lost with the child
                pipe.close()


def own_stdout() -> IO[str]:
    """A child's stdout, reserved for its lines to its parent: what libraries print goes to stderr from now on."""
    ours = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    return ours
