"""Workers of this machine: processes that get one item after another over a pipe. They listen on no port.

A process that dies costs its item a try, and nothing else: another process is started in its place. Python's own pools
give up as a whole then. All are forked from one process that does nothing but import what the work needs: its second or
two are spent once, whatever their number, and they share nothing with the caller.
"""

from __future__ import annotations

import multiprocessing as mp
import os
import signal
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

from cell.workers.work import TRIES, ItemT, ResultT, WorkerLost, lost

_END_S = 2.0
_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""One process a core is enough: with threads in each of them they would wait for each other."""


def here() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(frozen=True)
class LocalWorkers:
    """So many processes; with one, the work is done in this process.

    Attributes:
        with_children: the work starts processes of its own.
    """

    count: int
    with_children: bool = False

    def run(
        self, work: Callable[[ItemT], ResultT], items: Sequence[ItemT]
    ) -> Iterator[tuple[int, ResultT | WorkerLost]]:
        """As `Workers.run`."""
        if self.count <= 1:
            for index, item in enumerate(items):
                yield index, work(item)
            return
        crew = _Crew(work, items, self.with_children)
        try:
            yield from crew.results(min(self.count, len(items)))
        finally:
            crew.dismiss()


@dataclass
class _Worker:
    process: BaseProcess
    pipe: Connection
    index: int = -1


@dataclass
class _Crew:
    """The processes, and which item each of them works on."""

    work: Callable[[Any], Any]
    items: Sequence[Any]
    with_children: bool
    workers: list[_Worker] = field(default_factory=list)
    waiting: deque[int] = field(default_factory=deque)
    deaths: dict[int, int] = field(default_factory=dict)

    def results(self, count: int) -> Iterator[tuple[int, Any]]:
        self.waiting = deque(range(len(self.items)))
        while self.waiting or self.workers:
            while self.waiting and len(self.workers) < count:
                self._hire()
            ready = wait([worker.pipe for worker in self.workers])
            for worker in [worker for worker in self.workers if worker.pipe in ready]:
                yield from self._hear(worker)

    def _hire(self) -> None:
        context = mp.get_context("forkserver")  # a fork of this process would share its threads, locks and sessions
        context.set_forkserver_preload([_module_of(self.work)])
        ours, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs, self.work), daemon=not self.with_children)
        with _in_environment(_ONE_THREAD), _uninterrupted():
            process.start()
        theirs.close()  # then its end is the end of our pipe
        self.workers.append(_Worker(process, ours))
        self._give(self.workers[-1])

    def _give(self, worker: _Worker) -> None:
        worker.index = self.waiting.popleft()
        try:
            worker.pipe.send(self.items[worker.index])
        except OSError:  # it is dead, which is heard next
            return

    def _hear(self, worker: _Worker) -> Iterator[tuple[int, Any]]:
        try:
            result, error = worker.pipe.recv()
        except (EOFError, OSError):
            yield from self._bury(worker)
            return
        if error is not None:
            raise error
        yield worker.index, result
        if self.waiting:
            self._give(worker)
        else:
            self._release(worker)

    def _bury(self, worker: _Worker) -> Iterator[tuple[int, Any]]:
        self._release(worker)
        died = self.deaths[worker.index] = self.deaths.get(worker.index, 0) + 1
        if died < TRIES:
            self.waiting.appendleft(worker.index)
        else:
            yield worker.index, lost(died)

    def _release(self, worker: _Worker) -> None:
        self.workers.remove(worker)
        worker.pipe.close()
        worker.process.join(_END_S)

    def dismiss(self) -> None:
        """End what still runs: the caller has gone."""
        for worker in self.workers:
            worker.process.kill()
        for worker in [*self.workers]:
            self._release(worker)


def _module_of(work: Callable[..., Any]) -> str:
    """Return where the work is defined, for the import before any process is forked."""
    return str((work.func if isinstance(work, partial) else work).__module__)


@contextmanager
def _in_environment(added: Mapping[str, str]) -> Iterator[None]:
    """Context in which started processes have these variables, where they are not set otherwise."""
    new = {name: value for name, value in added.items() if name not in os.environ}
    os.environ.update(new)
    try:
        yield
    finally:
        for name in new:
            del os.environ[name]


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Context in which Ctrl-C waits, and interrupts no process that is started until `_serve` sees to it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(pipe: Connection, work: Callable[[Any], Any]) -> None:
    """A worker's life: an item, its result, until the pipe ends. Ctrl-C is the parent's to handle."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})  # of what it starts itself, too
    while True:
        try:
            item = pipe.recv()
        except EOFError:
            return
        try:
            said: tuple[Any, Exception | None] = (work(item), None)
        except Exception as error:  # noqa: BLE001 - it is raised again where the work was asked for
            said = (None, error)
        pipe.send(said)
