"""Closes what a program left open, when its main thread ends.

``atexit`` would be too late: the interpreter first waits for the bus's threads, which end only when it is closed.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from bus.threads import OwnedThread, Role, report_defect

Close = Callable[[], object]

_open: list[Close] = []
_changing = threading.Lock()
_waiting: list[OwnedThread] = []


def close_at_end(close: Close) -> None:
    """Have ``close`` called when the main thread has ended."""
    with _changing:
        _open.append(close)
        if not _waiting:
            _waiting.append(OwnedThread(Role.END, _wait, is_awaited=True).start())


def cancel_close_at_end(close: Close) -> None:
    """Have ``close`` not called at the end: it was called already. Idempotent."""
    with _changing:
        if close in _open:
            _open.remove(close)


def _wait() -> None:
    threading.main_thread().join()
    with _changing:
        left = list(reversed(_open))
    for close in left:
        try:
            close()
        except Exception as defect:  # noqa: BLE001 - the others are closed all the same, or the process never ends
            report_defect(str(Role.END), defect)
