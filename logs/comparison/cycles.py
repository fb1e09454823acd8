"""Compares two recorded cycles stage by stage: what differed in the input, in the decision, and in the outcome."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np

from bus.codec import Json
from bus.transforms import angle_between_rad
from logs.catalogue.column import Value
from logs.catalogue.columns import GROUPS
from logs.catalogue.rows import values_of
from logs.comparison.motion import MotionRow, compare_motion
from logs.mcap.reader import CycleRecord
from logs.recorded_settings import settings_in

Kind = Literal["input", "decision", "outcome"]
KINDS: tuple[Kind, ...] = ("input", "decision", "outcome")
STAGES = ("asked", "capture", "detect", "plan", "execute", "verify", "deliver", "result")
"""``asked`` is all that was there before the cycle, ``result`` how it ended."""

PLACES: dict[str, tuple[str, Kind]] = {
    "What was asked for": ("asked", "input"),
    "What it ran with": ("asked", "input"),
    "What was seen": ("detect", "input"),
    "What was imagined and found": ("detect", "decision"),
    "Goal-image models": ("detect", "decision"),
    "The chosen grasp": ("plan", "decision"),
    "Plan": ("plan", "decision"),
    "Who stepped in": ("execute", "input"),
    "Execute": ("execute", "outcome"),
    "Verify and deliver": ("verify", "outcome"),
    "How it ended": ("result", "outcome"),
    "Time of the stages": ("", "outcome"),
}
"""Stage and kind of the columns of each group of `logs.catalogue.columns`; a stage's time is of its own stage."""
LATER = {"What became of the recording"}
"""Groups of what came after the cycle, and says nothing of it."""
_EXCEPTIONS: dict[str, tuple[str, Kind]] = {
    **dict.fromkeys(("object", "number"), ("asked", "input")),
    **dict.fromkeys(("looks", "looked_again"), ("capture", "decision")),
    **dict.fromkeys(("warnings", "errors"), ("result", "outcome")),
    **dict.fromkeys(("released", "released_m", "laid_place", "laid_x_m", "laid_y_m", "laid_z_m"),
                    ("deliver", "outcome")),
}  # fmt: skip
_SKIPPED = {"cycle_id", "began", "started_ns", "day", "retry_of", "retried_as", "station_hash", "unread", "job_id",
            "job.job_id", "seed"}  # fmt: skip
"""They always differ, or say again what a setting says."""
_WHERE_IT_RUNS = ("bus.", "http.", "opcua.", "recording.")
"""Where a cell listens and records: settings that differ from cell to cell, and say nothing of a cycle."""
_NOTICEABLE = {"m": 5e-4, "rad": 5e-3, "N": 0.1, "Nm": 0.2, "s": 0.1, "m²": 1e-6, "px": 0.5, "USD": 0.0, "": 0.01}
"""Smaller differences of measured values are the noise of a second run; ``everything`` shows them, too."""


@dataclass(frozen=True)
class Row:
    """One value that differs.

    Attributes:
        stage: one of `STAGES`. ``name``: a column of the catalogue, a part of one, or a setting.
        a, b: both values; None where a cycle lacks it. ``unit``: of both, "" for none.
    """

    stage: str
    kind: Kind
    name: str
    a: Value
    b: Value
    unit: str
    meaning: str

    def to_json(self) -> Json:
        """Return the fields as a JSON object."""
        return asdict(self)


@dataclass(frozen=True)
class Comparison:
    """Two cycles beside each other; ``rows``: by stage, in each by kind. ``motion``: by segment."""

    a: CycleRecord
    b: CycleRecord
    rows: tuple[Row, ...]
    motion: tuple[MotionRow, ...]

    @property
    def first(self) -> Row | None:
        """The first difference in the order of cause and effect: all input, then decisions, then outcomes."""
        return min(self.rows, key=lambda row: KINDS.index(row.kind), default=None)

    def count(self, kind: Kind) -> int:
        """Return how many values of a kind differ."""
        return sum(row.kind == kind for row in self.rows)

    def to_json(self) -> Json:
        """Return the comparison as a JSON object."""
        first = self.first
        return {
            "a": self.a.cycle_id,
            "b": self.b.cycle_id,
            "counts": {kind: self.count(kind) for kind in KINDS},
            "first": first.to_json() if first is not None else None,
            "rows": [row.to_json() for row in self.rows],
            "motion": [row.to_json() for row in self.motion],
        }


def compare_cycles(a: CycleRecord, b: CycleRecord, *, everything: bool = False) -> Comparison:
    """Return what differs between two cycles, as `logs.mcap.reader.read_cycle` gives them.

    Args:
        everything: also measured values that differ by less than a second run of the same would.

    Raises: RecordingError for inconsistent values.
    """
    rows = [*_settings(a, b), *_pictures(a, b), *_columns(a, b)]
    shown = [row for row in rows if everything or _is_noticeable(row)]
    shown.sort(key=lambda row: (STAGES.index(row.stage), KINDS.index(row.kind)))
    return Comparison(a, b, tuple(shown), tuple(compare_motion(a, b)))


def _is_noticeable(row: Row) -> bool:
    if row.stage == "asked" and row.name.startswith(_WHERE_IT_RUNS):
        return False
    if isinstance(row.a, float) and isinstance(row.b, float):
        return abs(row.a - row.b) > _NOTICEABLE.get(row.unit, 0.0)
    return True


def _settings(a: CycleRecord, b: CycleRecord) -> Iterator[Row]:
    in_a, in_b = dict(settings_in(a.station)), dict(settings_in(b.station))
    for key in dict.fromkeys([*in_a, *in_b]):
        if in_a.get(key) != in_b.get(key):
            yield Row("asked", "input", key, _value(in_a.get(key)), _value(in_b.get(key)), "", "A setting.")


def _value(value: object) -> Value:
    if isinstance(value, bool) or value is None:
        return None if value is None else str(value).lower()
    return value if isinstance(value, str | int | float) else json.dumps(value)


def _pictures(a: CycleRecord, b: CycleRecord) -> Iterator[Row]:
    """Yield where the camera was, and how many pixels of the first look differ: by more than the noise of a camera."""
    if not a.looks or not b.looks:
        return
    one, other = a.looks[0], b.looks[0]
    poses = one.view.base_from_color, other.view.base_from_color
    moved_m, turned_rad = float(np.linalg.norm(poses[0][:3, 3] - poses[1][:3, 3])), angle_between_rad(*poses)
    if moved_m > 0 or turned_rad > 0:
        yield Row("capture", "input", "camera_moved_m", 0.0, moved_m, "m", "Distance between both cameras' places.")
        yield Row("capture", "input", "camera_turned_rad", 0.0, turned_rad, "rad", "Angle between both cameras.")
    if one.frame.color.shape == other.frame.color.shape:
        apart = np.abs(one.frame.color.astype(np.int16) - other.frame.color).max(axis=-1) > _NOISE
        if apart.any():
            meaning = f"Share of the pixels of the first look that differ by more than {_NOISE} of 255."
            yield Row("capture", "input", "pixels_changed", 0.0, float(apart.mean()), "", meaning)


_NOISE = 24


def _columns(a: CycleRecord, b: CycleRecord) -> Iterator[Row]:
    in_a, in_b = values_of(a), values_of(b)
    for group, columns in GROUPS:
        for column in columns:
            if column.name in _SKIPPED or group in LATER:
                continue
            stage, kind = _EXCEPTIONS.get(column.name, PLACES[group])
            stage = stage or column.name.removesuffix("_s")
            for name, one, other in _parts(column.name, in_a[column.name], in_b[column.name]):
                if name not in _SKIPPED and not _same(one, other):
                    yield Row(stage, kind, name, one, other, column.unit, column.meaning)


def _parts(name: str, a: Value, b: Value) -> Iterator[tuple[str, Value, Value]]:
    """The values of a column; of one that holds JSON objects, each of its parts."""
    objects = [_object(value) for value in (a, b)]
    if not any(objects) or not all(isinstance(value, str) or value is None for value in (a, b)):
        yield name, a, b
        return
    one, other = (found or {} for found in objects)
    for key in sorted({*one, *other}):
        yield f"{name}.{key}", _value(one.get(key)), _value(other.get(key))


def _object(value: Value) -> Json | None:
    if not isinstance(value, str) or not value.startswith("{"):
        return None
    try:
        found = json.loads(value)
    except ValueError:
        return None
    return found if isinstance(found, dict) else None


def _same(a: Value, b: Value) -> bool:
    if isinstance(a, float) and isinstance(b, float):
        return math.isclose(a, b, rel_tol=1e-12, abs_tol=1e-15)
    return a == b
