"""Migrates the content of older recordings to the current schema while reading.

A recording names the version of its content in its metadata (``schema``). Each migration converts the content of one
version to the next; the file is not changed. Add a row to `MIGRATIONS`, which raises `SCHEMA_VERSION`, whenever a
recorded message, the metadata or the attachments change in a way that affects the reader.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from bus.codec import Json
from bus.errors import RecordingError
from logs.mcap.unseen_scene import with_scene


@dataclass
class Content:
    """The content of a file.

    Attributes:
        metadata: all metadata records, merged. ``station``: the attached station, or None.
        payloads: (log time [ns UTC], bytes) of every message, by the topic's key.
    """

    metadata: dict[str, str] = field(default_factory=dict)
    station: Json | None = None
    payloads: dict[str, list[tuple[int, bytes]]] = field(default_factory=dict)


@dataclass(frozen=True)
class Migration:
    """One step from a version to the next.

    Attributes:
        since: the version it converts. ``what``: the change, for a person. ``change``: applies it in place.
    """

    since: int
    what: str
    change: Callable[[Content], None]


def _nothing(_content: Content) -> None:
    """Change the version number only."""


def _split_dirty(content: Content) -> None:
    commit = content.metadata.get("commit", "unknown")
    content.metadata["commit"] = commit.removesuffix("+")
    known = "yes" if commit.endswith("+") else "no"
    content.metadata["dirty"] = "unknown" if commit == "unknown" else known


def _say_what_was_seen(content: Content) -> None:
    key = "cycle/detect"
    if key in content.payloads:
        content.payloads[key] = [(time_ns, with_scene(payload)) for time_ns, payload in content.payloads[key]]


def _say_that_nothing_was_felt(content: Content) -> None:
    if content.station is not None:
        content.station = {"execute": {"contact_n": 0.0}, **content.station}
        planning = content.station.get("planning", {})
        if isinstance(planning, dict):
            content.station["planning"] = {"max_held_acceleration_m_s2": None, **planning}


def _say_that_it_passed_at_full_speed(content: Content) -> None:
    if content.station is not None:
        execute = content.station.get("execute", {})
        if isinstance(execute, dict):
            content.station = {**content.station, "execute": {"beside_m": 0.0, **execute}}


MIGRATIONS: tuple[Migration, ...] = (
    Migration(0, "The version is named: what names none is of before.", _nothing),
    Migration(1, "Whether the checkout had changes is `dirty`, no longer a + behind the commit.", _split_dirty),
    Migration(2, "A plan that failed lists what it rejected: nothing, where that was not kept.", _nothing),
    Migration(3, "Detect says what it saw, and which thing each grasp holds: its one object.", _say_what_was_seen),
    Migration(
        4,
        "An approach is slow at its end, and felt, and what is held is carried calmly; before, neither was.",
        _say_that_nothing_was_felt,
    ),
    Migration(
        5,
        "Before its slow end, an approach is slower where the hand passes something; before, it was not.",
        _say_that_it_passed_at_full_speed,
    ),
)
SCHEMA_VERSION = len(MIGRATIONS)
"""The version of new recordings."""


def migrate(content: Content) -> None:
    """Convert ``content`` to the current version, in place.

    Raises: RecordingError when its version is newer than this program, or invalid.
    """
    said = content.metadata.get("schema", "0")
    version = next((known for known in range(SCHEMA_VERSION + 1) if said == str(known)), -1)
    if not 0 <= version <= SCHEMA_VERSION:
        raise RecordingError(
            f"The recording has the schema version {said[:20]!r}; this program knows 0 to {SCHEMA_VERSION}.",
            "Read it with the version of `cell` that wrote it, or a newer one.",
        )
    for migration in MIGRATIONS[version:]:
        migration.change(content)
    content.metadata["schema"] = str(SCHEMA_VERSION)
