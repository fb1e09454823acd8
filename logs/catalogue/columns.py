"""THE table of columns: what the catalogue keeps of a cycle, and the version of that."""

from __future__ import annotations

import zlib

from logs.catalogue import cycle_columns, detect_columns, motion_columns, plan_columns
from logs.catalogue.column import Column

FILE_COLUMNS = (
    ("file", "TEXT", "Path of the recording, below the folder of recordings."),
    ("folder", "TEXT", "Its folder, below the folder of recordings."),
    ("name", "TEXT", "Its file name."),
    ("bytes", "INTEGER", "Its size."),
    ("mtime_ns", "INTEGER", "When it was written, UTC [ns]."),
)
"""Columns of the file itself: name, type, meaning."""

GROUPS: tuple[tuple[str, tuple[Column, ...]], ...] = (
    ("How it ended", cycle_columns.OUTCOME),
    ("Time of the stages", cycle_columns.TIMES),
    ("Execute", motion_columns.MOTION),
    ("Verify and deliver", motion_columns.VERDICT),
    ("Who stepped in", cycle_columns.PERSONS),
    ("The chosen grasp", plan_columns.CHOSEN),
    ("Plan", plan_columns.PLAN),
    ("What was seen", detect_columns.SEEN),
    ("What was imagined and found", detect_columns.IMAGINED),
    ("Goal-image models", detect_columns.MODELS),
    ("What was asked for", cycle_columns.JOB),
    ("What it ran with", cycle_columns.VERSIONS),
    ("What became of the recording", cycle_columns.KEPT),
)
"""The columns in the order of the table, under the heads of docs/catalogue.md."""

COLUMNS: tuple[Column, ...] = tuple(column for _, columns in GROUPS for column in columns)
NAMES: tuple[str, ...] = (*(name for name, _, _ in FILE_COLUMNS), *(column.name for column in COLUMNS))

BY_AGE = "coalesce(nullif(began, ''), name)"
"""Sorts rows as `logs.mcap.index.Entry.by_age` sorts entries."""

_MEANING = 1
"""Raise it when a column's value is taken otherwise under the same name and type: then all rows are made anew."""
LABEL_COLUMNS = (
    ("cycle_id", "TEXT", "The cycle it is of."),
    ("at_ns", "INTEGER", "When, UTC [ns]."),
    ("who", "TEXT", "The person."),
    ("label", "TEXT", "`good`, `bad`, or empty for a mere note."),
    ("note", "TEXT", "Free words."),
)
"""Columns of the table of labels: name, type, meaning."""


def _definitions(columns: tuple[tuple[str, str, str], ...]) -> str:
    return ", ".join(f"{name} {kind} NOT NULL" for name, kind, _ in columns)


TABLES = f"""
CREATE TABLE cycle ({_definitions(FILE_COLUMNS)},
    {", ".join(f"{column.name} {column.type}" for column in COLUMNS)}, PRIMARY KEY (file));
CREATE INDEX cycle_by_name ON cycle (name);
CREATE INDEX cycle_by_age ON cycle ({BY_AGE});
CREATE INDEX cycle_by_id ON cycle (cycle_id);
CREATE INDEX cycle_by_start ON cycle (started_ns);
CREATE INDEX cycle_by_folder ON cycle (folder, name, bytes, mtime_ns);
CREATE INDEX cycle_sums ON cycle
    (day, result, code, retried_as, wall_s, executed, held, stops, aborts, holds, cost_usd, started_ns);
CREATE TABLE labels ({_definitions(LABEL_COLUMNS)});
CREATE INDEX label_by_cycle ON labels (cycle_id, at_ns);
CREATE TABLE folders (folder TEXT PRIMARY KEY, mtime_ns INTEGER NOT NULL, ctime_ns INTEGER NOT NULL);
CREATE TABLE labels_file (bytes INTEGER NOT NULL, mtime_ns INTEGER NOT NULL);
CREATE TABLE deletions (file TEXT PRIMARY KEY, at INTEGER NOT NULL);
CREATE TABLE journal (bytes INTEGER NOT NULL);
CREATE VIEW cycles AS SELECT cycle.*,
    (SELECT label FROM labels WHERE labels.cycle_id = cycle.cycle_id AND label <> '' ORDER BY at_ns DESC LIMIT 1)
    AS label,
    (SELECT count(*) FROM labels WHERE labels.cycle_id = cycle.cycle_id AND note <> '') AS notes
    FROM cycle;
"""
SCHEMA = zlib.crc32(f"{_MEANING}{TABLES}".encode()) & 0x7FFF_FFFF
"""Of this table: a catalogue of any other is set aside, and made anew."""
