"""Prints lines for a person and JSON for a program. Printed text never acts on the terminal.

Much of the text is untrusted: of a model, a device, or a file name. It is never interpreted as markup or as a terminal
sequence; characters missing in the terminal's encoding are escaped; and an output that is lost (`| head`, a full disk)
does not end the program.
"""

from __future__ import annotations

import json
import logging
import math
import os
import re
import sys
from contextlib import suppress
from typing import Any, TextIO

Part = str | tuple[str, str]
"""A text, or a text and its style: words of `_CODES`."""

_CODES = {"bold": 1, "dim": 2, "red": 31, "green": 32, "yellow": 33, "magenta": 35, "cyan": 36}
_SEQUENCES = re.compile(
    r"(?:\x1b\[|\x9b)[0-?]*[ -/]*[@-~]"  # colours, cursor
    r"|(?:\x1b[\]PX^_]|[\x90\x98\x9d-\x9f])[^\x07\x1b\x9c]*(?:\x07|\x1b\\|\x9c)"  # titles, links, the clipboard
    r"|\x1b[ -/]*[0-Z\\^-~]"
)
_BREAKS = re.compile(r"[\t-\r\x1c-\x1f\x85\u2028\u2029]+")
_UNSEEN = re.compile(r"[\x00-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u202a-\u202e\u2066-\u2069\ufeff]")
"""Control characters, and characters that change the direction of the surrounding text."""
_SURROGATE = re.compile(r"[\ud800-\udfff]")
_BEYOND_ASCII = re.compile(r"[\x7f-\U0010ffff]")


def plain(text: str) -> str:
    r"""Return the text on one line, without terminal sequences; bytes of names that are not UTF-8 as ``\\xe9``."""
    if text.isascii() and text.isprintable():
        return text
    text = _UNSEEN.sub("", _BREAKS.sub(" ", _SEQUENCES.sub("", text)))
    return _SURROGATE.sub(lambda found: _escaped(ord(found[0])), text)


def _escaped(surrogate: int) -> str:
    return f"\\x{surrogate - 0xDC00:02x}" if 0xDC80 <= surrogate <= 0xDCFF else f"\\u{surrogate:04x}"


class Printer:
    """Prints to stdout, or to stderr; never raises. It is also a file, for `cell.terminal.drawing`.

    Attributes:
        lost: the error after which nothing can be printed any more, or None.
    """

    def __init__(self, *, stderr: bool = False) -> None:
        self._stderr = stderr
        self.lost: Exception | None = None

    def line(self, *parts: Part, style: str = "") -> None:
        """Print one line of all parts, unchanged; ``style`` applies to those without their own."""
        texts = [part if isinstance(part, tuple) else (part, style) for part in parts]
        self.write("".join(self._styled(plain(text), its) for text, its in texts) + "\n")
        self.flush()

    def json(self, value: Any) -> None:
        """Print a value, or a JSON text, in ASCII, which every terminal and program accepts."""
        text = value if isinstance(value, str) else json.dumps(_finite(value), allow_nan=False)
        self.write(_BEYOND_ASCII.sub(lambda found: json.dumps(found[0])[1:-1], text) + "\n")
        self.flush()

    def _styled(self, text: str, style: str) -> str:
        if not style or not text or not self.isatty() or os.environ.get("NO_COLOR"):
            return text
        return f"\x1b[{';'.join(str(_CODES[word]) for word in style.split())}m{text}\x1b[0m"

    # --- as a file ----------------------------------------------------------------------------------------------------

    @property
    def _stream(self) -> TextIO | None:
        """The current stream: tests and progress bars replace it."""
        stream: TextIO | None = sys.stderr if self._stderr else sys.stdout
        return getattr(stream, "rich_proxied_file", stream)

    @property
    def encoding(self) -> str:
        """The encoding of the stream."""
        return getattr(self._stream, "encoding", None) or "utf-8"

    def isatty(self) -> bool:
        """True for a terminal that can be drawn on."""
        with suppress(OSError, ValueError):
            return self._stream is not None and self._stream.isatty() and os.environ.get("TERM") != "dumb"
        return False

    def fileno(self) -> int:
        """Return the stream's file descriptor. Raises: OSError without one."""
        if self._stream is None:
            raise OSError("There is no output.")
        return self._stream.fileno()

    def write(self, text: str) -> int:
        """Write trusted text, or text made `plain`; return its length."""
        stream, encoding = self._stream, self.encoding
        if stream is None or self.lost is not None:
            return len(text)
        try:
            stream.write(text.encode(encoding, "backslashreplace").decode(encoding))
        except (OSError, ValueError) as error:
            self._give_up(stream, error)
        return len(text)

    def flush(self) -> None:
        """Flush the stream; errors only set `lost`."""
        stream = self._stream
        if stream is None or self.lost is not None:
            return
        try:
            stream.flush()
        except (OSError, ValueError) as error:
            self._give_up(stream, error)

    def _give_up(self, stream: TextIO, error: Exception) -> None:
        """Discard all further output, including what Python writes at its end."""
        self.lost = error
        with suppress(OSError, ValueError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            try:
                os.dup2(nowhere, stream.fileno())
            finally:
                os.close(nowhere)


def _finite(value: Any) -> Any:
    """The value with NaN and infinity as strings, as on the bus."""
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    return [_finite(one) for one in value] if isinstance(value, list | tuple) else value


out, err = Printer(), Printer(stderr=True)


class PlainFormatter(logging.Formatter):
    """Formats a log line with its message made `plain`; a traceback below it stays unchanged."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        """Return the message of the record, made `plain`."""
        return plain(super().formatMessage(record))


def log_plainly() -> None:
    """Send warnings and errors of this process to stderr, each on one line."""
    handler = logging.StreamHandler(err)
    handler.setFormatter(PlainFormatter("%(levelname)s %(name)s: %(message)s"))
    logging.basicConfig(level=logging.WARNING, handlers=[handler])
