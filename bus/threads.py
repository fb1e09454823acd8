"""Threads that own something. One that dies by an unforeseen exception would silently take with it what it owns.

So the product starts no thread in any other way (a lint rule enforces it), each has a role of the list below, and its
unforeseen end is reported to the process's handler: the daemon aborts the cell, a node ends with the reason.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum

_log = logging.getLogger(__name__)


class Role(StrEnum):
    """The thing a thread owns; every thread has one role."""

    MACHINE = "machine"
    """The machine's state: commands and ends of actions, handled one at a time."""
    ACTION = "action"
    """The action of one acting state."""
    DETECT = "detect"
    """One detection; a stop may abandon it."""
    RECORD = "record"
    """The publication of what one stage gave, while the next one computes."""
    MODEL_CALL = "model-call"
    """One call of a hosted model; a stop or its deadline may abandon it."""
    CYCLE_LOG = "cycle-log"
    """The file of one recording."""
    WATCHDOG = "watchdog"
    """The periodic check of the nodes' streams."""
    SUPERVISOR = "supervisor"
    """The process of one node or door: its end and its restart."""
    DOOR = "door"
    """The service of a door to other programs, and its hearing of the cell."""
    WORKER = "worker"
    """Queries of one kind, answered one after the other."""
    LOOP = "loop"
    """One stream of a node, at a fixed rate."""
    HAND = "hand"
    """One motion of the hand while the arm moves."""
    HAND_POLL = "hand-poll"
    """The newest state of a real hand."""
    CAMERA_READ = "camera-read"
    """The newest frame of a real camera."""
    LIVE_VIEW = "live-view"
    """The queue of messages for a viewer."""
    ROBOT_TF = "robot-tf"
    """The published poses of the arm's links."""
    RETENTION = "retention"
    """The deletion of old recordings."""
    CATALOGUE = "catalogue"
    """The rows of recorded cycles."""
    CLOCK = "clock"
    """The measurement of this process's starvation."""
    END = "end"
    """The closing of what a program left open, once its main thread has ended."""
    PROBE = "probe"
    """One check of the doctor, which may never return."""


OnDefect = Callable[[str, BaseException], None]
"""Called with the thread's name and the exception that ended it, on that thread."""

_handlers: list[OnDefect] = []
_changing = threading.Lock()


@contextmanager
def handled_by(handler: OnDefect) -> Iterator[None]:
    """Inside the context, ``handler`` is called when an owned thread of this process ends by an exception."""
    with _changing:
        _handlers.append(handler)
    try:
        yield
    finally:
        with _changing:
            _handlers.remove(handler)


class OwnedThread:
    """A thread whose unforeseen end is logged and reported to every handler of `handled_by`.

    Args:
        role: what it owns. ``of``: which one, where a process has several.
        run: its work; every exception that leaves it is a defect.
        is_awaited: the process does not end before the thread; others are daemon threads.
    """

    def __init__(self, role: Role, run: Callable[[], None], *, of: str = "", is_awaited: bool = False) -> None:
        self.name = f"{role}-{of}" if of else str(role)
        self._run = run
        self._thread = threading.Thread(target=self._guarded, name=self.name, daemon=not is_awaited)

    def start(self) -> OwnedThread:
        """Start the thread and return itself."""
        self._thread.start()
        return self

    def join(self, timeout_s: float | None = None) -> None:
        """Wait for its end, at most ``timeout_s`` [s]; return at once when it never started."""
        if self._thread.ident is not None:
            self._thread.join(timeout_s)

    def is_alive(self) -> bool:
        """Whether it has started and not ended."""
        return self._thread.is_alive()

    def _guarded(self) -> None:
        try:
            self._run()
        except BaseException as defect:  # noqa: BLE001 - every end must be reported
            report_defect(self.name, defect)


def report_defect(name: str, defect: BaseException) -> None:
    """Log ``defect`` of the thread ``name`` and call every handler; one that fails does not keep out the others."""
    _log.critical("defect in %s", name, exc_info=defect)
    with _changing:
        handlers = list(_handlers)
    for handler in handlers:
        try:
            handler(name, defect)
        except Exception:  # noqa: BLE001 - the next handler is called all the same
            _log.exception("defect in what handles the defect of %s", name)
