"""Reads TOML files as editors save them: UTF-8, with or without a byte order mark."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from bus.errors import ConfigError

BYTE_ORDER_MARK = "\ufeff"


def read_text(file: Path) -> str:
    """Return the file's text with its line ends unchanged. Raises: ConfigError unless it can be read and is UTF-8."""
    try:
        raw = file.read_bytes()
    except FileNotFoundError as error:
        raise ConfigError(
            f"There is no station file {file}.", "Is its path right? `cell config new FILE` writes one."
        ) from error
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        raise ConfigError(f"Cannot read the station file {file}: {error}.") from error
    try:
        return raw.decode()
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ConfigError(f"{file} is not UTF-8 text (line {line}).", "Save it as UTF-8 in your editor.") from error


def parsed(text: str, name: str) -> dict[str, Any]:
    """Return the tree of a TOML text. Raises: ConfigError naming ``name`` and the place of the mistake."""
    try:
        return tomllib.loads(text.removeprefix(BYTE_ORDER_MARK))
    except (ValueError, RecursionError) as error:  # a TOMLDecodeError is a ValueError; so is a number of 5000 digits
        raise ConfigError(f"{name} is not valid TOML: {error}.") from error
