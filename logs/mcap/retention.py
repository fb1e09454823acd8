"""The rule of what goes when space or time is limited: the oldest successes first, failures last, labelled never."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

from config.recording import RecordingSettings
from logs.mcap.index import FINE

DAY_NS = 24 * 3600 * 10**9
GB = 1e9


class Recorded(NamedTuple):
    """One recording as the rule sees it.

    Attributes:
        bytes: size, its page included. ``stamp_ns``: start of its cycle, UTC.
        result: of its metadata; "" when not read or unreadable, which is treated as a failure.
        is_pinned: it counts, but never goes: still being written, not recovered, pinned or labelled by a person.
        is_thin: its pictures were trimmed.
    """

    path: Path
    bytes: int
    stamp_ns: int
    result: str = ""
    is_pinned: bool = False
    is_thin: bool = False

    @property
    def is_fine(self) -> bool:
        """True when the recording needs no attention."""
        return self.result in FINE


class Due(NamedTuple):
    """One recording that goes, and by which setting: ``recording.keep_days = 30``."""

    file: Recorded
    act: Literal["delete", "thin"]
    why: str


class Plan(NamedTuple):
    """The recordings that go, the oldest first.

    Attributes:
        delete: now. ``soon``: within a day, if the cell records as much as during the last day. ``thin``: now.
        short: which limit is not met although all that may go is deleted, in words; "" = all are.
    """

    delete: tuple[Due, ...] = ()
    soon: tuple[Due, ...] = ()
    thin: tuple[Due, ...] = ()
    short: str = ""


def plan_retention(
    files: Sequence[Recorded], now_ns: int, settings: RecordingSettings, free_bytes: int | None = None
) -> Plan:
    """Apply the rule of `RecordingSettings`; the newest recording and pinned ones stay.

    Args:
        now_ns: UTC. ``free_bytes``: of the disk; None = not known, and `keep_free_gb` is not applied.
    """
    delete, short = _due(files, now_ns, settings, free_bytes, 0)
    gone = {one.file for one in delete}
    left = [file for file in files if file not in gone]
    grown = sum(file.bytes for file in files if now_ns - DAY_NS < file.stamp_ns <= now_ns)
    free_then = None if free_bytes is None else free_bytes + sum(file.bytes for file in gone)
    soon, _ = _due(left, now_ns + DAY_NS, settings, free_then, grown)
    return Plan(tuple(delete), tuple(soon), tuple(_thin(left, now_ns, settings)), short)


def _candidates(files: Sequence[Recorded]) -> list[Recorded]:
    """Return what may go, in the order in which it goes."""
    newest_ns = max((file.stamp_ns for file in files if not file.is_pinned), default=0)
    free = (file for file in files if not file.is_pinned and file.stamp_ns < newest_ns)
    return sorted(free, key=lambda file: (not file.is_fine, file.stamp_ns, file.path))


def _due(
    files: Sequence[Recorded], at_ns: int, settings: RecordingSettings, free_bytes: int | None, more_bytes: int
) -> tuple[list[Due], str]:
    """Return what is to be deleted then, after so many more bytes were recorded; and which limit is still not met."""
    kept_bytes = sum(file.bytes for file in files) + more_bytes
    free = None if free_bytes is None else free_bytes - more_bytes
    due = []
    for file in _candidates(files):
        why = _too_old(file, at_ns, settings) or _too_much(kept_bytes, free, settings)
        if why:
            due.append(Due(file, "delete", why))
            kept_bytes -= file.bytes
            free = None if free is None else free + file.bytes
    return due, _too_much(kept_bytes, free, settings)


def _too_old(file: Recorded, at_ns: int, settings: RecordingSettings) -> str:
    name, days = ("keep_days", settings.keep_days) if file.is_fine else ("keep_failed_days", settings.keep_failed_days)
    return f"recording.{name} = {days:g}" if days > 0 and at_ns - file.stamp_ns > days * DAY_NS else ""


def _too_much(kept_bytes: int, free_bytes: int | None, settings: RecordingSettings) -> str:
    if settings.keep_gb > 0 and kept_bytes > settings.keep_gb * GB:
        return f"recording.keep_gb = {settings.keep_gb:g}"
    if free_bytes is not None and free_bytes < settings.keep_free_gb * GB:
        return f"recording.keep_free_gb = {settings.keep_free_gb:g}"
    return ""


def _thin(files: Sequence[Recorded], at_ns: int, settings: RecordingSettings) -> list[Due]:
    days = settings.thin_after_days
    if days <= 0:
        return []
    why = f"recording.thin_after_days = {days:g}"
    old = (file for file in _candidates(files) if file.is_fine and at_ns - file.stamp_ns > days * DAY_NS)
    return [Due(file, "thin", why) for file in old if not file.is_thin]


def in_words(files: Sequence[Recorded]) -> str:
    """A summary: ``12 recordings (0.34 GB, 2 of them failures)``."""
    failures = sum(not file.is_fine for file in files)
    among = f", {failures} of them failures" if failures else ""
    return f"{len(files)} recordings ({sum(file.bytes for file in files) / GB:.2f} GB{among})"
