"""The trials of the soak, and their allowed outcomes.

The first trials use every row of `cell.daemon.fault_table`; then parts, kinds and moments are drawn at random, and
every
fourth trial has no fault.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.records import Attachment

from benchmarks.openness import trouble
from bus.codes import Code
from bus.errors import RecordingError
from bus.messages import CycleResult
from cell.daemon.fault_table import PICK_CODES, ROWS, Row
from logs.mcap.reader import read_cycle
from logs.mcap.recorder import PART
from logs.mcap.torn_reader import TornReader

MOMENTS = ("begin", "capture", "detect", "plan", "execute", "verify", "deliver")
_WITHOUT_FAULT = 0.25
_OBJECTS = ("bottle", "spatula", "controller", "cup", "drone")
"""The first is on the table from the start: presenting another one makes the simulator compile it."""


@dataclass(frozen=True)
class Trial:
    """One cycle to be: ``row`` None = without a fault; ``late_s``: after the moment began; ``walk``: the row's own."""

    number: int
    row: Row | None
    moment: str
    late_s: float
    object: str
    walk: bool


@dataclass(frozen=True)
class Outcome:
    """The result of one trial.

    Attributes:
        fault: the row's name, or "". ``result``, ``code``, ``reason``: of the cycle; "NONE" when none was said.
        is_explained, is_logged, is_idle: as the table allows; with a readable record; ready again in time.
        took_s: the cycle, and the way back to Idle. ``recording``: its path. ``was_held``: the cell was Held meanwhile.
    """

    number: int
    fault: str
    moment: str
    result: str
    code: str
    reason: str
    is_explained: bool
    is_logged: bool
    is_idle: bool
    took_s: float
    recording: str
    was_held: bool = False

    def line(self) -> str:
        marks = "".join(f" {word}" for word, good in (("UNEXPLAINED", self.is_explained), ("UNLOGGED", self.is_logged),
                                                      ("STUCK", self.is_idle)) if not good)  # fmt: skip
        what = f"{self.fault or '-'} @{self.moment}"
        return f"{self.number} {what}: {self.result} {self.code} {self.took_s:.1f} s{marks}  {self.reason}"


def rows_of(faults: str) -> tuple[Row, ...]:
    """``all``, ``none``, or parts separated by commas."""
    if faults in ("all", "none"):
        return ROWS if faults == "all" else ()
    return tuple(row for row in ROWS if row.part in faults.split(","))


def trials(rows: tuple[Row, ...], seed: int, first: int) -> Iterator[Trial]:
    """The endless series, from number ``first`` (0 = the first); each depends on seed and number only."""
    number = first
    while True:
        rng = np.random.default_rng([seed, number])
        if number < len(rows):
            yield Trial(number, rows[number], rows[number].sets_in, 0.0, _OBJECTS[0], True)
        else:
            row = None if rng.random() < _WITHOUT_FAULT or not rows else rows[int(rng.integers(len(rows)))]
            late_s = float(rng.uniform(0.0, 0.5)) if rng.random() < 0.5 else 0.0
            moment = str(rng.choice(MOMENTS)) if row is not None else ""
            yield Trial(number, row, moment, late_s, str(rng.choice(_OBJECTS)), False)
        number += 1


def explains(trial: Trial, was_injected: bool, result: CycleResult, objects_left: Callable[[], int | None]) -> bool:
    """Whether the table allows it; a SUCCESS also has to be one: ``objects_left`` is asked in the pick region."""
    if result.result == "SUCCESS" and objects_left() not in (0, None):
        return False
    if result.result not in ("SUCCESS", "EMPTY") and result.code in (None, Code.INTERNAL):
        return False
    if trial.walk and trial.row is not None:
        return (result.result, result.code) == (trial.row.result, trial.row.code)
    if trial.row is None or not was_injected:
        return result.result in ("SUCCESS", "FAILED") and result.code in (None, *PICK_CODES)
    return result.code in trial.row.allowed | set(PICK_CODES if result.result == "FAILED" else ())


def is_logged(result: CycleResult, trial: Trial) -> bool:
    """A recording that says the same, to others as well; after a fault of the disk, what was written before it."""
    path = Path(result.recording)
    if result.code is not Code.RECORDING:
        try:
            recorded = read_cycle(path).result
        except RecordingError:
            return False
        says_so = recorded is not None and (recorded.result, recorded.code) == (result.result, result.code)
        return says_so and not trouble(path)
    if trial.moment == "begin" or (trial.row is not None and trial.row.word == "garbage"):
        return True
    try:
        with path.with_name(path.name + PART).open("rb") as file:
            return any(isinstance(record, Attachment) for record in TornReader(file).records())
    except OSError:
        return False
