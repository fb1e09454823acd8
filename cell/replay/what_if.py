"""A chained replay as a cycle of its own, so that the page of a cycle shows what would have been."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from bus.messages import Failure
from cell.replay.compared_stages import STAGES
from cell.replay.replay import Replay
from cell.replay.view import consequence, why_it_ends
from logs.mcap.reader import CycleRecord, Stage
from logs.recorded_station import recorded_station

WHAT_IF = "WHAT_IF"
"""The outcome of such a cycle: nothing moved for it."""


def what_if(replay: Replay, overrides: Sequence[str]) -> CycleRecord:
    """Return the recorded cycle up to the first stage that ran again, then what these stages gave.

    What was done afterwards is left out: that followed from the recorded decisions. Its station has the overrides.

    Args:
        replay: chained. ``overrides``: its settings, as ``key=value``.
    """
    record = replay.record
    station = recorded_station(record, overrides)
    again = {one.stage: one.replayed for one in replay.stages}
    before = [stage.name for stage in STAGES[: [stage.name for stage in STAGES].index(replay.stages[0].stage)]]
    stages: dict[str, Stage] = {name: record.stages[name] for name in before if name in record.stages}
    last_ns = max((stage.started_ns for stage in stages.values()), default=0)
    for row in STAGES:
        if (outcome := again.get(row.name)) is not None:
            recorded = record.stages.get(row.name)
            last_ns = recorded.started_ns if recorded is not None else last_ns
            failed = isinstance(outcome, Failure)
            stages[row.name] = row.topic.says(
                cycle_id=record.cycle_id,
                stage=row.name,
                started_ns=last_ns,
                duration_s=0.0,
                result=None if failed else outcome,
                failure=outcome if failed else None,
            )
    return replace(
        record,
        metadata={**record.metadata, "result": WHAT_IF, "reason": _reason(replay, overrides)},
        station=station.model_dump(mode="json"),
        stages=stages,
        replies=record.replies if replay.replies is None else replay.replies,
        result=None,
        states=(),
        events=(),
        hand=(),
        health=(),
        arm=(),
        after=record.after if "verify" in again else None,
    )


def _reason(replay: Replay, overrides: Sequence[str]) -> str:
    changed = ", ".join(overrides) or "the code of today"
    came = "; ".join(consequence(replay))
    return " ".join([f"With {changed} - {came}.", *why_it_ends(replay)])
