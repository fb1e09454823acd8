"""The work that workers do, and what they say of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Protocol, TypeVar

from bus.errors import CellError

ItemT = TypeVar("ItemT")
ResultT = TypeVar("ResultT")
TRIES = 3
"""An item whose worker dies is given to another one; after so many deaths it counts as their cause."""


class WorkerLost(CellError):
    """The process that worked on an item died, each time it was tried."""

    exit_code = 2
    code = "WORKER_LOST"


def lost(tries: int) -> WorkerLost:
    """Return the error of one item."""
    return WorkerLost(f"Its worker died {tries} times.", "Run it alone with --workers 1, and see to the memory.")


class Workers(Protocol):
    """Whoever works on many items."""

    def run(
        self, work: Callable[[ItemT], ResultT], items: Sequence[ItemT]
    ) -> Iterator[tuple[int, ResultT | WorkerLost]]:
        """Yield each item's number with its result, as they come; the order depends on the workers, the results do not.

        Args:
            work: a function of a module, or a partial of one; it, its items and its results travel between processes.

        Raises: whatever ``work`` raises.
        """
        ...


def in_order(results: Iterable[tuple[int, ResultT]]) -> Iterator[tuple[int, ResultT]]:
    """Numbered results in the order of their numbers, each as soon as those before it are there."""
    early: dict[int, ResultT] = {}
    due = 0
    for index, found in results:
        early[index] = found
        while due in early:
            yield due, early.pop(due)
            due += 1
