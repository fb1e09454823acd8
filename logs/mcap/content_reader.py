"""Reads the content of one recording's file as it was recorded: metadata, station, and messages in bytes."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

from mcap.records import Attachment, Channel, McapRecord, Message, Metadata

from bus.codec import Json
from bus.errors import RecordingError
from logs.mcap.finished_reader import Summary, records
from logs.mcap.migrate import Content
from logs.mcap.names import reading, shown
from logs.mcap.recorder import PART
from logs.mcap.records import Damage

STATION = "station.json"
_STATION_DEPTH = 32


def read_content(path: Path) -> Content:
    """Return the whole content, with the checksum of the data verified. Raises: RecordingError."""
    require_finished(path)
    raw = Content()
    with reading(path), path.open("rb") as file:
        _fill(raw, records(file))
    return raw


def read_topics(path: Path, keys: Collection[str]) -> Content:
    """Return the content with the messages of these topics only; all of them where the file has no summary.

    Raises: RecordingError.
    """
    require_finished(path)
    with reading(path), path.open("rb") as file:
        summary = Summary(file)
        raw = _summed(summary, keys) if summary.is_there else None
    return raw or read_content(path)


def require_finished(path: Path) -> None:
    """Refuse a missing or unfinished recording. Raises: RecordingError."""
    with reading(path):
        is_file = path.is_file()
    if is_file and path.name.endswith(PART):
        raise RecordingError(
            f"{shown(path)} was not finished.",
            f"Its process ended in the cycle, or still writes: `cell recover {shown(path)}` makes it whole.",
        )
    if not is_file:
        raise RecordingError(f"There is no recording {shown(path)}.", "See `cell cycles`.")


def require_ours(path: Path, *, has_station: bool, metadata: Mapping[str, str]) -> None:
    """Refuse an MCAP of another program. Raises: RecordingError."""
    if not has_station or "cycle_id" not in metadata:
        raise RecordingError(f"{shown(path)} is an MCAP, but not a recording of this cell.", f"It lacks {STATION}.")


def station_tree(document: bytes) -> Json:
    """Return the attached station, a JSON document that is a tree of settings. Raises: Damage for any other."""
    try:
        tree = json.loads(document)
        json.dumps(tree, ensure_ascii=False).encode()  # raises for characters that cannot be encoded
    except (ValueError, RecursionError) as error:
        raise Damage(f"{STATION} is no JSON") from error
    if not isinstance(tree, dict) or not _is_shallow(tree, _STATION_DEPTH):
        raise Damage(f"{STATION} is no tree of settings")
    return tree


def _is_shallow(value: object, levels: int) -> bool:
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return levels > 0 and all(_is_shallow(one, levels - 1) for one in inner)


def _summed(summary: Summary, keys: Collection[str]) -> Content:
    """Return what the summary leads to. Raises: Damage, OSError."""
    raw = Content()
    for table in summary.metadata():
        raw.metadata.update(table.metadata)
    station = summary.attachment(STATION)
    raw.station = station_tree(station) if station is not None else None
    for topic, at_ns, payload in summary.timed_messages(frozenset(f"/{key}" for key in keys)):
        raw.payloads.setdefault(topic.removeprefix("/"), []).append((at_ns, payload))
    return raw


def _fill(raw: Content, found: Iterator[McapRecord]) -> None:
    """Read all records of the data section, checking its checksum; the summary only repeats them. Raises: Damage."""
    keys: dict[int, str] = {}
    for record in found:
        match record:
            case Metadata():
                raw.metadata.update(record.metadata)
            case Attachment(name=name) if name == STATION:
                raw.station = station_tree(record.data)
            case Channel():
                keys[record.id] = record.topic.removeprefix("/")
            case Message():
                if record.channel_id not in keys:
                    raise Damage("a message of it belongs to no channel")
                raw.payloads.setdefault(keys[record.channel_id], []).append((record.log_time, record.data))
