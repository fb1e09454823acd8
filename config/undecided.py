"""Lines of a station file that are still marked CHANGE or DECIDE: what a person has yet to decide."""

from __future__ import annotations

import re
from pathlib import Path

from config.toml_file import read_text

_MARK = re.compile(r"""^(?:[^#"']|"[^"]*"|'[^']*')*\#\s*(?:CHANGE|DECIDE)\b""")
"""A comment that begins with the word, on a line of its own or behind a value; no text of a setting is a comment."""


def undecided_in(file: Path) -> list[int]:
    """Return the numbers of the marked lines, from 1 on. Raises: ConfigError when the file cannot be read."""
    return [number for number, line in enumerate(read_text(file).splitlines(), 1) if _MARK.match(line)]


def undecided(file: Path) -> tuple[str, str] | None:
    """Return what is still to decide, in words, and what to do about it; None where nothing is. Raises: ConfigError."""
    lines = undecided_in(file)
    if not lines:
        return None
    holds = "lines still hold values" if len(lines) > 1 else "line still holds a value"
    said = f"{file}: {len(lines)} {holds} of another cell, or to decide on: {', '.join(map(str, lines))}"
    return said, "Put in this cell's own, and take the word CHANGE or DECIDE out of the line."
