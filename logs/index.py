"""Finds and lists what was recorded, newest first; a file that cannot be read is listed with its reason, not hidden."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Any

from mcap.reader import make_reader

from bus import topics
from bus.codec import decode
from bus.errors import BadPayload, RecordingError
from bus.messages import Attempt, CycleResult
from logs.reader import DAMAGE
from logs.recorder import PART

_FINE = ("SUCCESS", "EMPTY")
_SHOWN_MATCHES = 3


@dataclass(frozen=True)
class Entry:
    """One recording: its result, or why it cannot be read.

    Attributes:
        result: a cycle's, or ``UNFINISHED``, ``TORN`` (never closed), ``DAMAGED``.
        wall_s: how long the cycle took, None when it does not say.
        number: which try of its pick it was, from 0. ``retry_of``, ``retried_as``: ids of the tries beside it, or "".
    """

    path: Path
    cycle_id: str
    result: str
    code: str = ""
    reason: str = ""
    object: str = ""
    wall_s: float | None = None
    number: int = 0
    retry_of: str = ""
    retried_as: str = ""

    @property
    def failed(self) -> bool:
        """Whether somebody should look at it."""
        return self.result not in _FINE

    def to_json(self) -> dict[str, Any]:
        return {"recording": str(self.path)} | {key: value for key, value in asdict(self).items() if key != "path"}


@dataclass(frozen=True)
class Filter:
    """Which recordings are asked for.

    Attributes:
        failed: only those somebody should look at. ``code``: only this one.
        day: ``2026-11-28``, or only the beginning of one; "today".
        last: at most so many; None = all.
    """

    failed: bool = False
    code: str = ""
    day: str = ""
    last: int | None = None

    def dates(self, path: Path) -> bool:
        """Whether the recording is of the day asked for."""
        day = datetime.now(UTC).strftime("%Y-%m-%d") if self.day == "today" else self.day
        return path.name.startswith(day.replace("-", ""))

    def takes(self, entry: Entry) -> bool:
        return (entry.failed or not self.failed) and (not self.code or entry.code == self.code.upper())


def list_cycles(folder: Path, wanted: Filter | None = None) -> Iterator[Entry]:
    """Every recording below ``folder`` that is ``wanted``. Raises: RecordingError when there is no such folder."""
    wanted = wanted or Filter()
    entries = (read_entry(path) for path in recordings(folder) if wanted.dates(path))
    return islice((entry for entry in entries if wanted.takes(entry)), wanted.last)


def recordings(folder: Path) -> list[Path]:
    """The files, newest first. Raises: RecordingError when there is no such folder."""
    if not folder.is_dir():
        raise RecordingError(f"There is no folder {folder}.", "Nothing was recorded yet, or name another folder.")
    files = [*folder.rglob("*.mcap"), *folder.rglob(f"*.mcap{PART}")]
    return sorted(files, key=lambda path: path.name, reverse=True)


def find_recording(name: str, folder: Path) -> Path:
    """The recording that ``name`` means: a file, or a cycle of ``folder``: its id, or a part of no other's.

    Raises: RecordingError when there is none, or more than one.
    """
    path = Path(name)
    if path.exists() or path.suffix in (".mcap", PART) or len(path.parts) > 1:
        return path  # whoever reads it says what is wrong with it
    found = [path for path in recordings(folder) if name in _id_of(path)]
    whole = [path for path in found if _id_of(path) == name]
    if len(whole or found) == 1:
        return (whole or found)[0]
    if not found:
        raise RecordingError(f"There is no file {name}, and no cycle {name} in {folder}.", "See `cell cycles`.")
    some = ", ".join(_id_of(path) for path in found[:_SHOWN_MATCHES])
    more = " ..." if len(found) > _SHOWN_MATCHES else ""
    raise RecordingError(f"{len(found)} cycles have {name!r} in their id: {some}{more}.", "Write more of it.")


def read_entry(path: Path) -> Entry:
    """How one recording ended; never raises for what is wrong with the file."""
    name = _id_of(path)
    if path.suffix == PART:
        return Entry(path, name, "TORN", reason="not finished; `cell recover` makes it readable")
    try:
        return _closed(path, name)
    except DAMAGE as error:
        return Entry(path, name, "DAMAGED", reason=type(error).__name__)


def _id_of(path: Path) -> str:
    return path.name.partition(".")[0]


def _closed(path: Path, name: str) -> Entry:
    """The result in words of the file's metadata, and what its messages add. Raises: what damaged files do."""
    metadata: dict[str, str] = {}
    result: CycleResult | None = None
    attempt = Attempt(cycle_id=name)
    with path.open("rb") as file:
        reader = make_reader(file)
        for record in reader.iter_metadata():
            metadata.update(record.metadata)
        try:
            for _, channel, message in reader.iter_messages(topics=[f"/{topics.RESULT.key}", f"/{topics.ATTEMPT.key}"]):
                if channel.topic.endswith(topics.RESULT.key):
                    result = decode(CycleResult, message.data)
                else:
                    attempt = decode(Attempt, message.data)
        except BadPayload:  # of another version: what the metadata says still holds
            pass
    return Entry(
        path,
        metadata.get("cycle_id", name),
        metadata.get("result", "UNFINISHED"),
        metadata.get("code", ""),
        metadata.get("reason", ""),
        object=result.object if result is not None else "",
        wall_s=result.wall_s if result is not None else None,
        number=attempt.number,
        retry_of=attempt.retry_of,
        retried_as=result.retried_as if result is not None else "",
    )
