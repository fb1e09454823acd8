"""Single key presses at a terminal."""

from __future__ import annotations

import os
import re
import select
import termios
import time
import tty
from types import TracebackType
from typing import IO, Any

_ESCAPE_SEQUENCE = re.compile(rb"\x1b(\[[0-?]*[ -/]*[@-~]|O.|.)?", re.DOTALL)
_NO_CHARACTER = b"\0"  # POSIX: this control character is disabled


class Keyboard:
    """Key presses, unbuffered and unechoed while entered, when ``stdin`` is a terminal; otherwise none.

    Ctrl-C remains a signal; Ctrl-Z is disabled, so that no other program gets the terminal in this mode.
    """

    def __init__(self, stdin: IO[str]) -> None:
        self._fd = stdin.fileno() if stdin.isatty() else None
        self._before: Any = None

    @property
    def is_there(self) -> bool:
        """True when stdin is a terminal."""
        return self._fd is not None

    def __enter__(self) -> Keyboard:
        if self._fd is not None:
            self._before = termios.tcgetattr(self._fd)
            tty.setcbreak(self._fd)
            now = termios.tcgetattr(self._fd)
            now[6][termios.VSUSP] = _NO_CHARACTER
            termios.tcsetattr(self._fd, termios.TCSANOW, now)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._fd is not None:
            termios.tcsetattr(self._fd, termios.TCSADRAIN, self._before)

    def pressed(self, timeout_s: float) -> list[str]:
        """Return the keys pressed within ``timeout_s``, a held-down one once, none that send a sequence (arrows).

        Raises: EOFError when the terminal is gone.
        """
        if self._fd is None:
            time.sleep(timeout_s)
            return []
        if not select.select([self._fd], [], [], timeout_s)[0]:
            return []
        typed = os.read(self._fd, 1024)
        if not typed:
            raise EOFError
        return list(dict.fromkeys(_ESCAPE_SEQUENCE.sub(b"", typed).decode("ascii", "ignore")))
