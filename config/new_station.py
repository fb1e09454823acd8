"""A station file to begin with: only what a person must decide, each line with how to find out."""

from __future__ import annotations

import re
from pathlib import Path

_FOLDER = Path(__file__).parent / "new"
_CELL_ID = re.compile(r"[^a-z0-9_-]+")


def new_station(cell_id: str, *, simulated: bool = False) -> str:
    """Return the text of a new station file: an FR3 with its hand and a Femto Mega, or a simulated cell."""
    text = (_FOLDER / ("simulated.toml" if simulated else "robot.toml")).read_text()
    return text.replace('cell_id = "cell"', f'cell_id = "{cell_id}"')


def cell_id_of(file: Path) -> str:
    """Return a cell's name after its file's: lower case letters, digits, - and _; ``cell`` where none is left."""
    return _CELL_ID.sub("-", file.stem.lower()).strip("-_") or "cell"
