"""Handles requests to end a serving program: Ctrl-C, SIGTERM, or a closed terminal."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def on_end(end: Callable[[], None], *, insists: bool = False) -> None:
    """Call ``end`` at each of these signals, between any two steps of the main thread.

    A SIGHUP that is ignored (nohup) stays ignored.

    Args:
        insists: a second Ctrl-C or SIGTERM ends immediately. A second SIGHUP never does: a closed terminal sends
            several.
    """

    def handle(number: int, _frame: object) -> None:
        end()
        if insists and number != signal.SIGHUP:
            signal.signal(number, signal.SIG_DFL)

    for number in ENDING:
        if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handle)


@contextmanager
def ending(end: Callable[[], None]) -> Iterator[None]:
    """Context with `on_end`; restores the previous handlers afterwards."""
    before = {number: signal.getsignal(number) for number in ENDING}
    on_end(end)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
