"""Writes a new camera mounting into a station file, and touches nothing else of it."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Sequence
from pathlib import Path

from bus.errors import ConfigError

_KEYS = ("hand_from_color_position_m", "hand_from_color_wxyz")


def mounting_lines(position_m: Sequence[float], wxyz: Sequence[float]) -> dict[str, str]:
    """The two settings as lines of TOML, by key."""
    values = (", ".join(f"{value:.7f}" for value in position_m), ", ".join(f"{value:.9f}" for value in wxyz))
    return {key: f"{key} = [{value}]" for key, value in zip(_KEYS, values, strict=True)}


def with_mounting(text: str, position_m: Sequence[float], wxyz: Sequence[float], note: str) -> str:
    """``text`` of a station file with another camera mounting; the old one is kept as a comment.

    Raises: ConfigError when the file is written in a way this cannot change safely.
    """
    lines, new = text.splitlines(), mounting_lines(position_m, wxyz)
    header = next((i for i, line in enumerate(lines) if re.match(r"\s*\[camera\]\s*(#.*)?$", line)), None)
    if header is None:
        lines += ["", "[camera]", f"# {note}", *new.values()]
    else:
        end = next((i for i in range(header + 1, len(lines)) if re.match(r"\s*\[", lines[i])), len(lines))
        table = [_kept(line) for line in lines[header + 1 : end]]
        lines[header + 1 : end] = [f"# {note}", *new.values(), *table]
    written = "\n".join(lines) + "\n"
    _require_only_the_mounting_changed(text, written)
    return written


def write_mounting(path: Path, position_m: Sequence[float], wxyz: Sequence[float], note: str) -> None:
    """Change the file at once or not at all. Raises: ConfigError, saying why not."""
    try:
        written = with_mounting(path.read_text(), position_m, wxyz, note)
        part = path.with_suffix(".part")
        part.write_text(written)
        os.replace(part, path)
    except OSError as error:
        raise ConfigError(f"The station file {path} cannot be written: {error}.", "Copy the printed lines.") from error


def _kept(line: str) -> str:
    """The old values become comments."""
    return f"# before: {line.strip()}" if re.match(rf"\s*({'|'.join(_KEYS)})\s*=", line) else line


def _require_only_the_mounting_changed(before: str, after: str) -> None:
    old = tomllib.loads(before)
    try:
        new = tomllib.loads(after)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(
            f"The camera's table cannot be changed automatically: {error}.", "Copy the printed lines."
        ) from error
    for tree in (old, new):
        camera = tree.setdefault("camera", {})
        for key in _KEYS:
            camera.pop(key, None)
    if old != new:
        raise ConfigError("The camera's table cannot be changed automatically.", "Copy the printed lines.")
