"""Threads that own something. A thread that ends by an exception nobody foresaw takes with it what it owns, unseen.

So no thread of the product is started in any other way (a lint rule sees to it), each has a role of the list below, and
its unforeseen end is told to whoever keeps this process: the daemon aborts the cell, a node ends with the reason.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum

_log = logging.getLogger(__name__)


class Role(StrEnum):
    """What a thread owns; every thread has one of these."""

    MACHINE = "machine"
    """The machine's state: it takes commands and ends of work, one at a time."""
    ACTION = "action"
    """What one acting state does."""
    DETECT = "detect"
    """One detection, which a stop may leave behind."""
    MODEL_CALL = "model-call"
    """One call of a hosted model, which a stop or its deadline may leave behind."""
    CYCLE_LOG = "cycle-log"
    """The file of one recording."""
    WATCHDOG = "watchdog"
    """The looks at the nodes' streams."""
    SUPERVISOR = "supervisor"
    """One node's process: its end, and its next start."""
    WORKER = "lane"
    """Questions of one kind, answered one after the other."""
    LOOP = "loop"
    """One stream of a node, at a fixed rate."""
    HAND_POLL = "hand-poll"
    """The newest state of a real hand."""
    CAMERA_READ = "camera-read"
    """The newest frame of a real camera."""
    LIVE_VIEW = "live-view"
    """What a viewer is still to be sent."""
    ROBOT_TF = "robot-tf"
    """Where the arm's links are, as it is said."""
    RETENTION = "retention"
    """The recordings that are kept no longer."""
    PROBE = "probe"
    """One question of the doctor that may never be answered."""


OnDefect = Callable[[str, BaseException], None]
"""Told the thread's name and what ended it, on that thread."""

_handlers: list[OnDefect] = []
_changing = threading.Lock()


@contextmanager
def handled_by(handler: OnDefect) -> Iterator[None]:
    """Inside, ``handler`` is told when an owned thread of this process ends by an exception."""
    with _changing:
        _handlers.append(handler)
    try:
        yield
    finally:
        with _changing:
            _handlers.remove(handler)


class OwnedThread:
    """A daemon thread whose unforeseen end is logged, and told to every handler of `handled_by`.

    Args:
        role: what it owns. ``of``: which one, where a process has several.
        run: what it does; every exception that leaves it is a defect.
    """

    def __init__(self, role: Role, run: Callable[[], None], *, of: str = "") -> None:
        self.name = f"{role}-{of}" if of else str(role)
        self._run = run
        self._thread = threading.Thread(target=self._guarded, name=self.name, daemon=True)

    def start(self) -> OwnedThread:
        """Begin; returns itself."""
        self._thread.start()
        return self

    def join(self, timeout_s: float | None = None) -> None:
        """Wait for its end; at once when it never began."""
        if self._thread.ident is not None:
            self._thread.join(timeout_s)

    def is_alive(self) -> bool:
        """Whether it has begun, and not ended."""
        return self._thread.is_alive()

    def _guarded(self) -> None:
        try:
            self._run()
        except BaseException as defect:  # noqa: BLE001 - whatever it is, somebody must know
            report_defect(self.name, defect)


def report_defect(name: str, defect: BaseException) -> None:
    """Log ``defect`` of what is called ``name``, and tell every handler; one that fails keeps none of the others."""
    _log.critical("defect in %s", name, exc_info=defect)
    with _changing:
        handlers = list(_handlers)
    for handler in handlers:
        try:
            handler(name, defect)
        except Exception:  # noqa: BLE001 - the next one is told all the same
            _log.exception("defect in what handles the defect of %s", name)
