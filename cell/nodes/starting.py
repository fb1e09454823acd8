"""Starts a child process of the cell, a node or a door, and waits for its first line: it is ready, or why it is not."""

from __future__ import annotations

import logging
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from typing import TypeVar

from bus.clock import DeadlineClock
from bus.codec import decode
from bus.errors import BadPayload, CellError
from bus.remote_errors import error_from_reply
from cell.nodes.pipes import close_pipes, has_ended, line_within
from cell.nodes.ready import Open, Ready
from config.schema import Station

_log = logging.getLogger(__name__)
SLOW_S = 10.0
"""Who waits longer is told for whom."""
_END_S = 5.0
"""Longest time until a child that cannot start has ended by itself."""

SaidT = TypeVar("SaidT", Ready, Open)


def spawn_child(station: Station, *module: str, secret: str | None = None) -> subprocess.Popen[str]:
    """Start ``python -m MODULE`` with the station as the first line of its stdin, and a secret as the second."""
    child = subprocess.Popen(
        [sys.executable, "-P", "-m", *module],  # -P: the working folder must not hide our modules
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        encoding="utf-8",  # independent of the terminal's
        start_new_session=True,  # Ctrl-C in the terminal reaches the parent only, which ends the child in order
    )
    assert child.stdin is not None
    try:
        child.stdin.write(f"{station.model_dump_json()}\n")
        if secret is not None:
            child.stdin.write(f"{secret}\n")
        child.stdin.flush()
    except BrokenPipeError:
        _log.error("%s ended before it read its station", " ".join(module))
    return child


def first_said(
    child: subprocess.Popen[str],
    kind: type[SaidT],
    within_s: float,
    clock: DeadlineClock,
    silent: Callable[[int | None], CellError],
    slow: Callable[[], None] = lambda: None,
) -> SaidT:
    """Wait for the child's first line, and return it.

    Args:
        silent: makes the error of a child that says nothing of this kind, from its exit code; from None where it still
            ran when the time was over.
        slow: called once where the child takes longer than a person waits without a word.

    Raises: the child's own error, or that of ``silent``; the child has ended then, and its pipes are closed.
    """
    assert child.stdout is not None
    line = line_within(child.stdout, min(SLOW_S, within_s), clock)
    if line is None:
        slow()
        line = line_within(child.stdout, within_s - SLOW_S, clock)
    if line is None:
        _end(child)
        raise silent(None)
    try:
        said = decode(kind, line.encode())
    except BadPayload as error:
        _end(child)
        raise silent(child.returncode) from error
    if said.error is not None:
        clock.wait_for(partial(has_ended, child), _END_S)
        _end(child)
        raise error_from_reply(said.error)
    return said


def _end(child: subprocess.Popen[str]) -> None:
    """End the child by force, unless it has ended."""
    child.kill()
    child.wait()
    close_pipes(child)
