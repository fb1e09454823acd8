"""Runs the same work on many items: in this process, in processes of this machine, or on a cluster that is there."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from cell.workers.cluster import ClusterWorkers
from cell.workers.local import LocalWorkers, here
from cell.workers.work import ItemT, ResultT, WorkerLost, Workers, in_order

__all__ = ["ClusterWorkers", "LocalWorkers", "WorkerLost", "Workers", "here", "in_order", "ordered", "workers_for"]

_PER_WORKER = 4
"""A process of its own costs a second or two of imports: fewer items than this are not worth one."""


def workers_for(items: int, count: int | None, scheduler: str) -> Workers:
    """Return the workers for so many items.

    Args:
        count: processes of this machine; None = one a core, fewer for a few items; 1 = this process itself.
        scheduler: the address of a Dask scheduler, "" for none.

    Raises: ConfigError when ``scheduler`` is named and Dask is not installed.
    """
    if scheduler:
        return ClusterWorkers(scheduler)
    return LocalWorkers(count or max(1, min(here(), items // _PER_WORKER)))


def ordered(
    workers: Workers, work: Callable[[ItemT], ResultT], items: Sequence[ItemT]
) -> Iterator[ResultT | WorkerLost]:
    """Yield the results of the workers, in the order of the items."""
    for _, found in in_order(workers.run(work, items)):
        yield found
