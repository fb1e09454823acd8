"""A station file to begin with: only what a person must decide, each line with how to find out."""

from __future__ import annotations

import re
from enum import StrEnum
from pathlib import Path

_FOLDER = Path(__file__).parent
_CELL = re.compile(r'^cell_id = "[^"]*"', re.MULTILINE)
_CELL_ID = re.compile(r"[^a-z0-9_-]+")


class Kind(StrEnum):
    """A kind of new station file: its value is the file that it is a copy of, beside this module."""

    ROBOT = "new/robot.toml"
    """An FR3 with its hand and a Femto Mega."""
    SIMULATED = "new/simulated.toml"
    BIN = "bin.toml"
    """A simulated cell with a bin of objects."""


def new_station(cell_id: str, kind: Kind = Kind.ROBOT) -> str:
    """Return the text of a new station file."""
    return _CELL.sub(f'cell_id = "{cell_id}"', (_FOLDER / kind.value).read_text(), count=1)


def cell_id_of(file: Path) -> str:
    """Return a cell's name after its file's: lower case letters, digits, - and _; ``cell`` where none is left."""
    return _CELL_ID.sub("-", file.stem.lower()).strip("-_") or "cell"
