"""The command ``cell``: looks whether this Python can import the command, then carries it out (`cell.command`).

Until then it imports nothing but Python's own: whatever else an import finds depends on the caller's environment.
"""

from __future__ import annotations

import importlib
import signal
import sys
from collections.abc import Callable

from cell.installation import hidden, not_installed

_USAGE = 2


def run() -> None:
    """Entry point: carry out the command of this process, and end."""
    _command()()


def _command() -> Callable[[], None]:
    """Return `cell.command.run`; exit with one line when this Python cannot import it. Ctrl-C ends that at once."""
    on_interrupt = signal.getsignal(signal.SIGINT)
    if on_interrupt is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    if problem := hidden():
        _refuse(problem)
    try:
        command: Callable[[], None] = importlib.import_module("cell.command").run
    except ImportError as error:
        if not (problem := not_installed(error)):
            raise
        _refuse(problem)
    signal.signal(signal.SIGINT, on_interrupt)
    return command


def _refuse(problem: str) -> None:
    sys.stderr.write(f"INSTALLATION: {problem}\n")
    sys.exit(_USAGE)


if __name__ == "__main__":
    run()
