"""Columns of the cycle as a whole: which it was, how it ended, what was asked, who stepped in, what it ran with."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from datetime import UTC, datetime

from bus.distribution import OURS
from logs.catalogue.column import Column, Told, Value
from logs.mcap.index import BEGAN, began_of
from logs.mcap.reader import RECOVERED
from logs.mcap.thin import ARCHIVED, ARCHIVED_SHA256, THINNED

UNFINISHED = "UNFINISHED"
_STAMP = re.compile(r"\d{8}T\d{9}")
_COMMANDED = re.compile(r"command '\w+' from (?!cell$)")
"""The reason of a state that a client commanded, and not the cell itself."""
_PAUSED = frozenset({"Holding", "Held", "Suspending", "Suspended"})
_NAMED = ("schema", "cell_id", "station_hash", "seed", "robot_model_sha256", "commit", "dirty", "python", OURS)
_OF_THE_RESULT = ("cycle_id", BEGAN, "result", "code", "reason", RECOVERED, THINNED, ARCHIVED, ARCHIVED_SHA256)


# --- when -------------------------------------------------------------------------------------------------------------


def stamp_ns(cycle_id: str) -> int | None:
    """Start of a cycle by its id, UTC [ns]; None for an id of another form."""
    if not _STAMP.fullmatch(cycle_id):
        return None
    try:
        began = datetime.strptime(f"{cycle_id}000", "%Y%m%dT%H%M%S%f").replace(tzinfo=UTC)
    except ValueError:
        return None
    return round(began.timestamp() * 1e3) * 10**6


def day_of(started_ns: int | None) -> str | None:
    """Return the day of a time, UTC."""
    if started_ns is None:
        return None
    return f"{datetime.fromtimestamp(started_ns / 1e9, UTC):%Y-%m-%d}"


def _started_ns(told: Told) -> int | None:
    by_id = stamp_ns(told.record.cycle_id)
    return by_id if by_id is not None else min((run.started_ns for run in told.runs), default=None)


# --- parts ------------------------------------------------------------------------------------------------------------


def _metadata(key: str) -> Callable[[Told], Value]:
    return lambda told: told.record.metadata.get(key)


def _versions(told: Told) -> Value:
    others = {key: value for key, value in told.record.metadata.items() if key not in (*_NAMED, *_OF_THE_RESULT)}
    return json.dumps(dict(sorted(others.items())))


def _seed(told: Told) -> Value:
    said = told.record.metadata.get("seed", "")
    return int(said) if re.fullmatch(r"-?\d{1,18}", said) else None


def _result(name: str) -> Callable[[Told], Value]:
    """A text or number of the cycle's result; None without a result."""
    return lambda told: getattr(told.record.result, name) if told.record.result is not None else None


def _of_job(told: Told, part: str) -> Value:
    asked = getattr(told.record.attempt.job, part)
    if asked is None:
        return None
    said = asked.model_dump(mode="json", exclude_none=True)
    first = next(iter(said.values()), None)
    return first if len(said) == 1 and isinstance(first, str) else json.dumps(said)


def _job(told: Told) -> Value:
    return told.record.attempt.job.model_dump_json(exclude_defaults=True)


def _failed_stage(told: Told) -> Value:
    return next((name for name, stage in told.record.stages.items() if stage.failure is not None), None)


def _took_s(stage: str) -> Callable[[Told], Value]:
    def take(told: Told) -> Value:
        runs = [run.duration_s for run in told.runs if run.stage == stage]
        return sum(runs) if runs else None

    return take


# --- who stepped in ---------------------------------------------------------------------------------------------------


def _changes(told: Told) -> Iterator[tuple[str, str, int, int]]:
    """The machine's states in order: name, reason, begin and end [ns UTC], one each however often it was published."""
    changes: list[tuple[str, str, int]] = []
    for said in told.record.states:
        if not changes or changes[-1][0] != said.message.state:
            changes.append((said.message.state, said.message.reason, said.log_time_ns))
    end_ns = told.record.states[-1].log_time_ns if told.record.states else 0
    for (state, reason, begin_ns), after in zip(changes, [*(one[2] for one in changes[1:]), end_ns], strict=False):
        yield state, reason, begin_ns, after


def _commanded(state: str) -> Callable[[Told], Value]:
    """Return a function that counts how often a client commanded that state."""
    return lambda told: sum(
        name == state and _COMMANDED.match(reason) is not None for name, reason, _, _ in _changes(told)
    )


def _paused_s(told: Told) -> Value:
    return sum(end_ns - begin_ns for name, _, begin_ns, end_ns in _changes(told) if name in _PAUSED) / 1e9


def _events(severity: str) -> Callable[[Told], Value]:
    return lambda told: sum(said.message.severity == severity for said in told.record.events)


# --- the columns ------------------------------------------------------------------------------------------------------

OUTCOME = (
    Column("cycle_id", "TEXT", "", "UTC time at which it was asked for, to the millisecond: its start, unless it"
           " waited.", lambda told: told.record.cycle_id),
    Column("began", "TEXT", "", "UTC time of its start, to the millisecond: cycles are listed by it. Empty in older"
           " recordings.", lambda told: began_of(told.record.metadata)),
    Column("started_ns", "INTEGER", "ns", "When it was asked for, UTC.", _started_ns),
    Column("day", "TEXT", "", "Of that time, UTC: `2026-11-28`.", lambda told: day_of(_started_ns(told))),
    Column(
        "result",
        "TEXT",
        "",
        "SUCCESS, FAILED, ABORTED or EMPTY; UNFINISHED without one; DAMAGED: the file cannot be read.",
        lambda told: told.record.metadata.get("result", UNFINISHED),
    ),
    Column("code", "TEXT", "", "Why not SUCCESS: one of `bus/codes.py`; else empty.",
           lambda told: told.record.metadata.get("code", "")),
    Column("reason", "TEXT", "", "The same in words.", lambda told: told.record.metadata.get("reason", "")),
    Column("object", "TEXT", "", "Name of the presented object; empty on hardware.",
           lambda told: told.record.result.object if told.record.result is not None else ""),
    Column("wall_s", "REAL", "s", "Duration of the cycle.", _result("wall_s")),
    Column("number", "INTEGER", "", "Number of the attempt within its pick, from 0.",
           lambda told: told.record.attempt.number),
    Column("retry_of", "TEXT", "", "Id of the attempt before; empty for the first.",
           lambda told: told.record.attempt.retry_of),
    Column("retried_as", "TEXT", "", "Id of the attempt after; empty: the pick ended here.",
           lambda told: told.record.result.retried_as if told.record.result is not None else ""),
    Column("failed_stage", "TEXT", "", "The stage that failed.", _failed_stage),
    Column("unread", "TEXT", "", "Why nothing but the outcome could be read; NULL: all of it was.", lambda _: None),
)  # fmt: skip

PERSONS = (
    Column("stops", "INTEGER", "", "Stops that a client commanded in the cycle.", _commanded("Stopping")),
    Column("aborts", "INTEGER", "", "Aborts that a client commanded in it.", _commanded("Aborting")),
    Column("holds", "INTEGER", "", "Holds that a client commanded in it.", _commanded("Holding")),
    Column("paused_s", "REAL", "s", "Time held or suspended, whoever asked.", _paused_s),
    Column("warnings", "INTEGER", "", "Events of this severity in the cycle.", _events("warning")),
    Column("errors", "INTEGER", "", "Events of this severity in the cycle.", _events("error")),
)

JOB = (
    Column("asked_by", "TEXT", "", "`client_id` of the command that asked for it, which begins with the interface;"
           " empty: not known.", lambda told: told.record.attempt.asked_by),
    Column("job_id", "TEXT", "", "The client's own name for what it asked.",
           lambda told: told.record.attempt.job.job_id),
    Column("target", "TEXT", "", "What was to be picked: its words, else JSON; NULL: anything.",
           lambda told: _of_job(told, "target")),
    Column("asked_place", "TEXT", "", "Where it was to be laid: name of a place, else JSON; NULL: the tray.",
           lambda told: _of_job(told, "place")),
    Column("job", "TEXT", "", "The whole job as JSON, without defaults.", _job),
)  # fmt: skip

TIMES = tuple(
    Column(f"{stage}_s", "REAL", "s", f"Time in {stage}, of all its runs together; NULL: it did not run.",
           _took_s(stage))
    for stage in ("capture", "detect", "plan", "execute", "verify", "deliver")
)  # fmt: skip

VERSIONS = (
    Column("station_hash", "TEXT", "", "Of the whole configuration.", _metadata("station_hash")),
    Column("cell_id", "TEXT", "", "Which cell.", _metadata("cell_id")),
    Column("seed", "INTEGER", "", "Of the simulation.", _seed),
    Column("version", "TEXT", "", f"Of `{OURS}`.", _metadata(OURS)),
    Column("commit_id", "TEXT", "", "Of the checkout.", _metadata("commit")),
    Column("dirty", "TEXT", "", "Whether the checkout had changes: yes, no, unknown.", _metadata("dirty")),
    Column("python", "TEXT", "", "Version.", _metadata("python")),
    Column("robot_model_sha256", "TEXT", "", "Of the robot's description.", _metadata("robot_model_sha256")),
    Column("recovered", "INTEGER", "", "1: made whole by `cell recover`.",
           lambda told: RECOVERED in told.record.metadata),
    Column("versions", "TEXT", "", "Versions of the packages, as JSON.", _versions),
)  # fmt: skip

KEPT = (
    Column("trimmed", "INTEGER", "", "1: its pictures were trimmed.", lambda told: THINNED in told.record.metadata),
    Column("deleted_ns", "INTEGER", "ns", "When its recording was deleted, UTC; NULL: it is there.", lambda _: None),
    Column("deleted_by", "TEXT", "", "The setting that asked for it.", lambda _: None),
    Column("archived", "TEXT", "", "Address of its whole recording, of one that was deleted or trimmed; NULL: none.",
           lambda told: told.record.metadata.get(ARCHIVED)),
)  # fmt: skip
"""Columns about the fate of the recording; of a deleted one the journal says it."""
