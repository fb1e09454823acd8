"""The turns in which simulated time passes: one device at a time; the fingers with anybody's ticks, or their own."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class Turns:
    """The turn to tick. An arm, or who lays objects, takes it for a whole motion; fingers only while nobody does."""

    def __init__(self) -> None:
        self._change = threading.Condition()
        self._is_taken = False
        self._asking = 0

    @contextmanager
    def taken(self) -> Iterator[None]:
        """Wait for the turn, and keep it while the block runs."""
        self._take()
        try:
            yield
        finally:
            self._give()

    @contextmanager
    def lent(self) -> Iterator[None]:
        """While the block runs, let others tick; the caller has the turn."""
        self._give()
        try:
            yield
        finally:
            self._take()

    def ride(self, is_over: Callable[[], bool], tick: Callable[[], None]) -> None:
        """Return once ``is_over``, which ticks bring about: those of who has the turn, else of the caller."""
        while not is_over():
            with self._change:
                self._change.wait_for(lambda: is_over() or not (self._is_taken or self._asking))
                if is_over():
                    return
                self._is_taken = True
            try:
                tick()
            finally:
                self._give()

    def wake(self) -> None:
        """Let the waiting look again."""
        with self._change:
            self._change.notify_all()

    def _take(self) -> None:
        with self._change:
            self._asking += 1
            try:
                self._change.wait_for(lambda: not self._is_taken)
            finally:
                self._asking -= 1
            self._is_taken = True

    def _give(self) -> None:
        with self._change:
            self._is_taken = False
            self._change.notify_all()
