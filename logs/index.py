"""Lists what was recorded, newest first; a file that cannot be read is listed with its reason, not hidden."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.reader import make_reader

from bus.errors import RecordingError
from logs.reader import DAMAGE


@dataclass(frozen=True)
class Entry:
    """One recording: its result, or why it cannot be read."""

    path: Path
    cycle_id: str
    result: str
    code: str
    reason: str

    def to_json(self) -> dict[str, Any]:
        return {
            "recording": str(self.path),
            "cycle_id": self.cycle_id,
            "result": self.result,
            "code": self.code,
            "reason": self.reason,
        }

    def line(self) -> str:
        """One line for a person."""
        return f"{self.cycle_id:<20} {self.result:<8} {self.code:<13} {self.reason}  {self.path}"


def list_cycles(folder: Path) -> list[Entry]:
    """Every recording below ``folder``. Raises: RecordingError when there is no such folder."""
    if not folder.is_dir():
        raise RecordingError(f"There is no folder {folder}.", "Nothing was recorded yet, or name another folder.")
    files = [*folder.rglob("*.mcap"), *folder.rglob("*.mcap.part")]
    return [_entry(path) for path in sorted(files, key=lambda path: path.name, reverse=True)]


def _entry(path: Path) -> Entry:
    name = path.name.partition(".")[0]
    if path.suffix == ".part":
        return Entry(path, name, "TORN", "", "not finished")
    metadata: dict[str, str] = {}
    try:
        with path.open("rb") as file:
            for record in make_reader(file).iter_metadata():
                metadata.update(record.metadata)
    except DAMAGE as error:
        return Entry(path, name, "DAMAGED", "", type(error).__name__)
    return Entry(
        path,
        metadata.get("cycle_id", name),
        metadata.get("result", "UNKNOWN"),
        metadata.get("code", ""),
        metadata.get("reason", ""),
    )
