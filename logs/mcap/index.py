"""Finds recordings, and reads what a list says of each; an unreadable one has the reason in it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from datetime import UTC, date, datetime
from pathlib import Path
from typing import IO

from mcap.records import Attachment, Channel, Message, Metadata

from bus import topics
from bus.codec import Json, decode
from bus.codes import went_for
from bus.errors import BadPayload, ConfigError, RecordingError
from bus.messages import Attempt, CycleResult
from logs.mcap.content_reader import STATION, require_ours, station_tree
from logs.mcap.finished_reader import Summary, records
from logs.mcap.names import found_below, is_folder, reading, shown
from logs.mcap.recorder import PART

BEGAN = "began"
"""Key of the metadata: when the cycle began, in the form of its id, which is of when it was asked for."""
FINE = ("SUCCESS", "EMPTY")
"""Results that need no attention."""
_DAY = re.compile(r"[0-9]{4}(-[0-9]{2}){0,2}")
_SHOWN_MATCHES = 3
_ELSEWHERE = "See `cell cycles`, or name the folder that it lies in: --folder."
_STAMP = re.compile(r"\d{8}T\d{9}")
_RESULT = f"/{topics.RESULT.key}"
_SHOWN = frozenset({_RESULT, f"/{topics.ATTEMPT.key}"})


@dataclass(frozen=True)
class Entry:
    """One recording: its result, or why it cannot be read.

    Attributes:
        result: a cycle's, or ``UNFINISHED``, ``TORN`` (never closed), ``DAMAGED``.
        code, reason: of a failure. ``object``: name of the object.
        wall_s: duration of the cycle, None when unknown.
        number: number of the attempt within its pick, from 0. ``retry_of``, ``retried_as``: ids of the adjacent
            attempts,
            or "".
        asked_by: the client that asked for it, "" = not known.
        began: when it began, in the form of an id: later than that for a pick that waited; "" = not known.
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
    asked_by: str = ""
    began: str = ""

    @property
    def by_age(self) -> str:
        """Sorts entries by when they began, and where that is not known by the names of their files."""
        return self.began or self.path.name

    @property
    def went_for(self) -> str:
        """What the cycle went for, for a person."""
        return went_for(self.code, self.object, self.reason)

    @property
    def failed(self) -> bool:
        """True when a person should examine the recording."""
        return self.result not in FINE

    def to_json(self) -> Json:
        """Return the fields as a JSON object, with the path as ``recording``."""
        return {"recording": shown(self.path), **{name: getattr(self, name) for name in _TOLD}}


_TOLD = tuple(one.name for one in fields(Entry) if one.name != "path")


@dataclass(frozen=True)
class Filter:
    """Selects recordings.

    Attributes:
        failed: only those that a person should examine. ``code``: only this code.
        day: ``2026-11-28``, or a prefix of a day; "today".
        last: at most this many; None = all.
        now: UTC; None = of this machine's clock.
    """

    failed: bool = False
    code: str = ""
    day: str = ""
    last: int | None = None
    now: datetime | None = None

    @property
    def digits(self) -> str:
        """The digits that the names of the selected day's recordings begin with."""
        return day_named(self.day, self.now).replace("-", "")

    def at_one_time(self) -> Filter:
        """Return the same filter, with the clock read."""
        return replace(self, now=self.now or datetime.now(UTC))

    @property
    def to_come(self) -> tuple[str, str]:
        """Times and names from the first to before the second are to come: the clock was set back since.

        They are older than all others, so that what the cell records now is the newest also then.
        """
        return f"{self.now or datetime.now(UTC):%Y%m%dT%H%M%S}~", ":"  # "~" and ":" come after every digit

    def age(self, began: str) -> tuple[bool, str]:
        """A key that sorts times, as in `Entry.by_age`, and names by age, the newest last."""
        first, end = self.to_come
        return not first <= began < end, began

    def dates(self, path: Path) -> bool:
        """True when the recording is of the selected day."""
        return path.name.startswith(self.digits)

    def takes(self, entry: Entry) -> bool:
        """True when the entry has the selected result and code."""
        return (entry.failed or not self.failed) and (not self.code or entry.code == self.code.upper())


def day_named(day: str, now: datetime | None = None) -> str:
    """Return the day that is meant, e.g. ``2026-11-28``; "today" is that of ``now`` (UTC; None = of the clock).

    Raises: ConfigError for what is neither a day nor the month or year of one.
    """
    if day == "today":
        return f"{now or datetime.now(UTC):%Y-%m-%d}"
    if day and not _is_day(day):
        raise ConfigError(f"{day!r} is no day.", "A day is today, 2026-11-28, 2026-11 or 2026 (UTC).")
    return day


def _is_day(day: str) -> bool:
    if _DAY.fullmatch(day) is None:
        return False
    with suppress(ValueError):
        return bool(date.fromisoformat(f"{day}-01-01"[:10]))
    return False


def recordings(folder: Path) -> list[Path]:
    """Return the recordings' files, newest first. Raises: RecordingError when the folder does not exist."""
    if not is_folder(folder):
        raise RecordingError(
            f"There is no folder {shown(folder)}.", "Nothing was recorded yet, or name another folder."
        )
    files = [*found_below(folder, "*.mcap"), *found_below(folder, f"*.mcap{PART}")]
    return sorted(files, key=lambda path: path.name, reverse=True)


def is_a_path(name: str) -> bool:
    """Whether a recording's name is that of a file, and not a cycle's id or a part of it. Raises: RecordingError."""
    path = Path(name)
    with reading(path):
        is_there = path.exists()
    return is_there or path.suffix in (".mcap", PART) or len(path.parts) > 1


def the_one(name: str, among: Sequence[Path], folder: Path) -> Path:
    """Return the recording of the cycle with this id or an unambiguous part of it, among those of ``folder``.

    Raises: RecordingError when there is none, or more than one.
    """
    found = [path for path in among if name in _id_of(path)]
    whole = [path for path in found if _id_of(path) == name]
    if len(whole or found) == 1:
        return (whole or found)[0]
    if not found:
        path = shown(Path(name))
        raise RecordingError(f"There is no file {path}, and no cycle {path} in {shown(folder)}.", _ELSEWHERE)
    some = ", ".join(_id_of(path) for path in found[:_SHOWN_MATCHES])
    more = " ..." if len(found) > _SHOWN_MATCHES else ""
    raise RecordingError(f"{len(found)} cycles have {name!r} in their id: {some}{more}.", "Write more of it.")


def began_of(metadata: Mapping[str, str]) -> str:
    """When a cycle began, by its metadata; "" where they do not say so, as those of older recordings."""
    said = metadata.get(BEGAN, "")
    return said if _STAMP.fullmatch(said) else ""


def read_entry(path: Path) -> Entry:
    """Return the entry of one recording; errors of the file become part of the entry and are never raised."""
    name = _id_of(path)
    if path.suffix == PART:
        return Entry(path, name, "TORN", reason="not finished; `cell recover` makes it readable")
    try:
        return _closed(path, name)
    except RecordingError as error:
        return Entry(path, name, "DAMAGED", reason=error.text.removeprefix(f"{shown(path)} "))


def read_result(path: Path) -> CycleResult | None:
    """Return the result in one recording, None without one. Raises: RecordingError, BadPayload."""
    results = [payload for topic, payload in _look(path).said if topic == _RESULT]
    return decode(CycleResult, results[-1]) if results else None


def read_metadata(path: Path) -> dict[str, str]:
    """All metadata tables of one recording, merged; the cheapest read of it. Raises: RecordingError."""
    return _look(path, topics=frozenset()).metadata


def _id_of(path: Path) -> str:
    return shown(Path(path.name)).partition(".")[0]


def _closed(path: Path, name: str) -> Entry:
    """The entry of a closed file, from its metadata and its messages. Raises: RecordingError."""
    seen = _look(path)
    require_ours(path, has_station=seen.station is not None, metadata=seen.metadata)
    with reading(path):
        station_tree(seen.station or b"")
    result: CycleResult | None = None
    attempt = Attempt(cycle_id=name)
    with suppress(BadPayload):  # a message of another version: the metadata is still valid
        for topic, payload in seen.said:
            if topic == _RESULT:
                result = decode(CycleResult, payload)
            else:
                attempt = decode(Attempt, payload)
    return Entry(
        path,
        seen.metadata.get("cycle_id", name),
        seen.metadata.get("result", "UNFINISHED"),
        seen.metadata.get("code", ""),
        seen.metadata.get("reason", ""),
        object=result.object if result is not None else "",
        wall_s=result.wall_s if result is not None else None,
        number=attempt.number,
        retry_of=attempt.retry_of,
        retried_as=result.retried_as if result is not None else "",
        asked_by=attempt.asked_by,
        began=began_of(seen.metadata),
    )


@dataclass
class _Look:
    """The part of a file that was read.

    Attributes:
        metadata: merged. ``station``: the attached document. ``said``: topics and payloads.
    """

    metadata: dict[str, str] = field(default_factory=dict)
    station: bytes | None = None
    said: list[tuple[str, bytes]] = field(default_factory=list)


def _look(path: Path, topics: frozenset[str] = _SHOWN) -> _Look:
    """Read the metadata, the station and the messages of ``topics``. Raises: RecordingError."""
    seen = _Look()
    with reading(path), path.open("rb") as file:
        summary = Summary(file)
        if not summary.is_there:
            return _walked(file, topics)
        for table in summary.metadata():
            seen.metadata.update(table.metadata)
        seen.station = summary.attachment(STATION)
        seen.said = list(summary.messages(topics))
    return seen


def _walked(file: IO[bytes], topics: frozenset[str]) -> _Look:
    """As `_look`, for a file without an index."""
    seen = _Look()
    names: dict[int, str] = {}
    for record in records(file):
        match record:
            case Metadata():
                seen.metadata.update(record.metadata)
            case Attachment(name=name) if name == STATION:
                seen.station = record.data
            case Channel():
                names[record.id] = record.topic
            case Message() if names.get(record.channel_id) in topics:
                seen.said.append((names[record.channel_id], record.data))
    return seen
