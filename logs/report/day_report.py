"""Report pages of a folder: one per cycle beside its recording, and one per day that links them, failures first."""

from __future__ import annotations

import json
import math
import os
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple
from urllib.parse import quote

import numpy as np

from bus.codes import ADVICE
from bus.errors import RecordingError
from logs.catalogue import known_entries
from logs.mcap.index import Entry, recordings
from logs.mcap.names import shown
from logs.mcap.reader import read_cycle
from logs.mcap.recorder import PART
from logs.recorded_settings import recorded_number
from logs.report.cycle_report import write_report
from logs.report.page import VERSION, write_page
from logs.report.trend import trend

INDEX = "index.html"
_HEAD_BYTES = 1 << 17
"""Bytes to read of a page: its head with the summary, thumbnail included, is shorter."""
_MARK = f'<meta name="vlad-cell-page" content="{VERSION} {INDEX}">'
_MARKS = '<script id="summary" type="application/json">', "</script>"
_SHOWN_S = (0.01, 0.1, 1.0, 10.0, 100.0)
_STAGES = ("capture", "detect", "plan", "approve", "execute", "verify", "deliver")


class Row(NamedTuple):
    """One cycle on the day's page; ``page`` is "" where there is none."""

    entry: Entry
    page: str
    why: str
    thumbnail: str
    again: tuple[str, ...] = ()


class Summary(NamedTuple):
    """The summary in a cycle's page; ``times_s``: duration of each stage. ``again``: why it looked again, each time."""

    is_there: bool
    why: str
    thumbnail: str
    times_s: Mapping[str, float]
    again: tuple[str, ...] = ()


_NO_SUMMARY = Summary(False, "", "", {})
_NONE: Mapping[Path, str] = MappingProxyType({})


class Spread(NamedTuple):
    """The durations of one stage over a day [s].

    Attributes:
        dots: position of each cycle on the axis [%], and its title. ``middle``: position of the median [%].
    """

    stage: str
    median_s: float
    p90_s: float
    most_s: float
    dots: tuple[tuple[float, str], ...]
    middle: float


def days(folder: Path) -> list[Path]:
    """Return the folders at and below ``folder`` with recordings, newest first. Raises: RecordingError for none."""
    found = list(dict.fromkeys(path.parent for path in recordings(folder)))
    if not found:
        raise RecordingError(f"There is no recording in {shown(folder)}.", "Cycles are recorded into recording.folder.")
    return found


def outdated(folder: Path) -> list[Path]:
    """Return the recordings whose page is missing, older than they are, or of another version; newest first."""
    return [path for path in recordings(folder) if path.suffix != PART and path.is_file() and not _is_current(path)]


def write_cycle(path: Path) -> str:
    """Write the page of one recording beside it; return the reason when that fails, or ""."""
    try:
        write_report(read_cycle(path), path.with_suffix(".html"), index=INDEX)
    except RecordingError as error:
        return error.text.removeprefix(f"{shown(path)} ")
    return ""


def write_day(day: Path, damaged: Mapping[Path, str] = _NONE) -> Path:
    """Write the page of one folder's cycles, and return it.

    Args:
        damaged: recordings whose page could not be written, and why.

    Raises: RecordingError when it cannot be written.
    """
    summaries: dict[Path, Summary] = {}
    rows, read = [], known_entries(day)
    for path in recordings(day):
        if path.parent != day:
            continue
        entry = read(path)
        if path in damaged:
            entry = replace(entry, result="DAMAGED", reason=damaged[path])
        has_page = path.suffix != PART and path not in damaged
        summaries[path] = said = _summary(path.with_suffix(".html")) if has_page else _NO_SUMMARY
        page = quote(os.fsencode(path.with_suffix(".html").name)) if said.is_there else ""
        rows.append(Row(entry, page, said.why or entry.reason, said.thumbnail, said.again))
    ids = [row.entry.cycle_id[:8] for row in rows]
    content = {
        "title": f"{ids[0][:4]}-{ids[0][4:6]}-{ids[0][6:]}" if ids[0].isdigit() else shown(Path(day.name)),
        "rows": sorted(rows, key=lambda row: not row.entry.failed),  # stable: newest first among themselves
        "outcomes": Counter(row.entry.result for row in rows).most_common(),
        "trend": trend([row.entry for row in rows]),
        "objects": sorted({row.entry.object for row in rows if row.entry.object}),
        "codes": _codes(rows),
        "spreads": _spreads(rows, summaries),
        "ticks": [(_at(value), f"{value:g} s") for value in _SHOWN_S],
        "busy_s": sum(row.entry.wall_s or 0.0 for row in rows),
    }
    return write_page("day.html.j2", content, day / INDEX)


def _is_current(recording: Path) -> bool:
    page = recording.with_suffix(".html")
    try:
        if not page.is_file() or page.stat().st_mtime < recording.stat().st_mtime:
            return False
    except OSError:  # one of them was deleted meanwhile
        return False
    return _MARK in _head(page) and _summary(page).is_there


def _head(page: Path) -> str:
    try:
        with page.open("rb") as file:
            return file.read(_HEAD_BYTES).decode("utf-8", "replace")
    except OSError:
        return ""


def _summary(page: Path) -> Summary:
    """The summary in the page's head (`logs.report.cycle_report`); anything else found there is ignored."""
    text = _head(page).partition(_MARKS[0])[2].partition(_MARKS[1])[0]
    try:
        said = json.loads(text)
    except (ValueError, RecursionError):
        return _NO_SUMMARY
    if not isinstance(said, dict) or not said:
        return _NO_SUMMARY
    why, thumbnail = (said[key] if isinstance(said.get(key), str) else "" for key in ("why", "thumbnail"))
    times_s = {stage: recorded_number(said, "stages", stage) for stage in _STAGES}
    again = tuple(one for one in said["again"] if isinstance(one, str)) if isinstance(said.get("again"), list) else ()
    return Summary(True, why, thumbnail, {stage: value for stage, value in times_s.items() if value is not None}, again)


def _codes(rows: Sequence[Row]) -> list[tuple[str, int, str]]:
    """(code, count, advice), the most frequent first."""
    advice = {code.value: text for code, text in ADVICE.items()}
    counts = Counter(row.entry.code for row in rows if row.entry.code)
    return [(code, count, advice.get(code, "")) for code, count in counts.most_common()]


def _spreads(rows: Sequence[Row], summaries: Mapping[Path, Summary]) -> list[Spread]:
    times: dict[str, list[tuple[float, str]]] = defaultdict(list)
    for row in rows:
        for stage, took_s in summaries[row.entry.path].times_s.items():
            times[stage].append((took_s, f"{row.entry.cycle_id}: {took_s:.2f} s"))
    return [_spread(stage, times[stage]) for stage in _STAGES if times[stage]]


def _spread(stage: str, times: Sequence[tuple[float, str]]) -> Spread:
    values_s = [value for value, _ in times]
    median_s, p90_s = (float(value) for value in np.percentile(values_s, [50, 90]))
    dots = tuple((_at(value), title) for value, title in times)
    return Spread(stage, median_s, p90_s, max(values_s), dots, _at(median_s))


def _at(value_s: float) -> float:
    """Position of a duration on the logarithmic axis [%]."""
    first, last = math.log10(_SHOWN_S[0]), math.log10(_SHOWN_S[-1])
    return 100 * min(1.0, max(0.0, (math.log10(max(value_s, 1e-6)) - first) / (last - first)))
