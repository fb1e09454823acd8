"""The journal of what was deleted and trimmed: appended to one file beside the recordings, never changed.

A line is written before its recording goes, and holds the row of the cycle, so that the catalogue can be made anew.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from bus.errors import CatalogueError
from bus.frozen import Message
from logs.catalogue.column import Value
from logs.catalogue.lines import append_line

JOURNAL = "deleted.jsonl"


class Gone(Message):
    """One recording that was deleted or trimmed, in one line of the journal.

    Attributes:
        file: path below the folder of recordings, at that time. ``at_ns``: UTC. ``why``: the setting that asked for it.
        freed_bytes: of the recording and its page; 0 for a trimmed one, which is not known before.
        archived, sha256: address of the copy of the whole recording, and its checksum; "" without one.
        row: what the catalogue knew of it, by the names of its columns; of a trimmed one nothing, for it has a file.
    """

    file: str
    cycle_id: str
    at_ns: Annotated[int, Field(ge=0, lt=2**62)]
    what: Literal["deleted", "trimmed"]
    why: str
    freed_bytes: int = 0
    archived: str = ""
    sha256: str = ""
    row: Mapping[str, Value] = {}

    def in_words(self) -> str:
        """One line: ``deleted on 2026-11-28 by recording.keep_days = 30; whole at s3://...``."""
        where = f"whole at {self.archived}" if self.archived else "nowhere whole"
        return f"{self.what} on {datetime.fromtimestamp(self.at_ns / 1e9, UTC):%Y-%m-%d} by {self.why}; {where}"


def append(root: Path, gone: Gone) -> None:
    """Append one line below the folder of recordings, synced to the disk. Raises: CatalogueError."""
    append_line(root / JOURNAL, json.dumps(gone.model_dump()).encode())


def journal_bytes(root: Path) -> int:
    """Its size; 0 without one."""
    try:
        return (root / JOURNAL).stat().st_size
    except OSError:
        return 0


def read_journal(root: Path, start: int = 0) -> Iterator[tuple[int, int, Gone | None]]:
    """Yield the lines from an offset on: where each begins and ends [bytes], and None for one that is no line of ours.

    A last line that is not ended is still being written.

    Raises: CatalogueError.
    """
    path = root / JOURNAL
    try:
        with path.open("rb") as file:
            file.seek(start)
            for line in file:
                if line.endswith(b"\n"):
                    yield start, start + len(line), _parsed(line)
                    start += len(line)
    except FileNotFoundError:
        return
    except OSError as error:
        raise CatalogueError(f"{path} cannot be read: {error.strerror}.", "Check who may read it.") from error


def last_of(root: Path, name: str) -> Gone | None:
    """Return the last deletion of the one cycle whose id has ``name`` in it; None for none, or several.

    Raises: CatalogueError.
    """
    found = {
        gone.cycle_id: gone
        for _, _, gone in read_journal(root)
        if gone is not None and gone.what == "deleted" and name in gone.cycle_id
    }
    return found.get(name) or (next(iter(found.values())) if len(found) == 1 else None)


def _parsed(line: bytes) -> Gone | None:
    with suppress(ValidationError):
        return Gone.model_validate_json(line)
    return None
