"""The labels that persons give to cycles: appended to one small file beside the recordings, never changed.

One JSON object a line. The catalogue holds a copy, which is made anew whenever the file has changed.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from bus.errors import CatalogueError
from bus.frozen import Message
from logs.catalogue.lines import append_line

LABELS = "labels.jsonl"
WORDS = ("good", "bad")


class Label(Message):
    """The label of one person for one cycle, in one line of its file.

    Attributes:
        at_ns: UTC. ``who``: the person. ``label``: "" for a mere note.
    """

    cycle_id: str
    at_ns: Annotated[int, Field(ge=0, lt=2**62)]
    who: str
    label: Literal["good", "bad", ""] = ""
    note: str = ""

    def in_words(self) -> str:
        """One line: ``labelled    bad by anna, 2026-11-28 09:12 UTC: it slipped``."""
        at = f"{datetime.fromtimestamp(self.at_ns / 1e9, UTC):%Y-%m-%d %H:%M} UTC"
        note = f": {self.note}" if self.note else ""
        return f"labelled    {self.label or 'note'} by {self.who}, {at}{note}"


def append(root: Path, label: Label) -> Path:
    """Append one label below the folder of recordings, synced to the disk; return the file. Raises: CatalogueError."""
    path = root / LABELS
    append_line(path, json.dumps(label.model_dump()).encode())
    return path


def read_labels(root: Path) -> list[Label]:
    """All labels in order; a line that is none is left out. Raises: CatalogueError."""
    return list(_labels(root / LABELS))


def labels_of(root: Path, cycle_id: str) -> list[Label]:
    """Return the labels of one cycle in order. Raises: CatalogueError."""
    return [one for one in _labels(root / LABELS) if one.cycle_id == cycle_id]


def _labels(path: Path) -> Iterator[Label]:
    try:
        lines = path.read_bytes().splitlines()
    except FileNotFoundError:
        return
    except OSError as error:
        raise CatalogueError(f"{path} cannot be read: {error.strerror}.", "Check who may read it.") from error
    for line in lines:
        with suppress(ValidationError):
            yield Label.model_validate_json(line)
