"""Reruns the pure stages of a recorded cycle and reports the first difference, in the order of cause and effect.

*Isolated*: every stage gets its recorded inputs, so the stage that changed is the one that differs. *Chained*: the
output of a stage is the input of the next, which shows the consequence of a change, up to the verdict.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, cast

from bus.codes import FROM_OUTSIDE
from bus.errors import ConfigError, CycleFailure, PicturesTrimmed, RecordingError, StageNotReached
from bus.frozen import Message
from bus.messages import Detections, Failure, ModelReply, PickPlan, StageName, StageRecord
from cell.replay.compared_stages import STAGES, Stage
from cell.replay.made_with import opening
from config.keys import value_at
from config.schema import Station
from logs.differences import Difference, compare
from logs.mcap.reader import CycleRecord
from logs.recorded_station import recorded_station
from perception.goal.imagine import OnReply
from perception.models import Models, open_models, replayed_models
from perception.models.registry import is_replayed
from planning.robot import Robot

PURE = tuple(stage.name for stage in STAGES if stage.pure)
ModelsOf = Callable[[Station, CycleRecord], Models]


@dataclass(frozen=True)
class StageReplay:
    """One stage, rerun.

    Attributes:
        recorded: its recorded output; None when the cycle ended before it. ``replayed``: its output now.
        differences: in the order of cause and effect, each with the step of the stage it belongs to.
    """

    stage: StageName
    recorded: Message | None
    replayed: Message
    differences: tuple[tuple[str, Difference], ...]


@dataclass(frozen=True)
class Changed:
    """A setting of a "what if?".

    Attributes:
        key: its name. ``before``, ``now``: what was recorded, or its default then; and what was given.
    """

    key: str
    before: Any
    now: Any


@dataclass(frozen=True)
class Replay:
    """A cycle, rerun.

    Attributes:
        stages: those that were rerun, in order. ``not_reached``: stage -> the reason.
        chained: the output of a stage was the input of the next.
        changed: the settings that were given.
        replies: of the goal-image model that was asked anew; None: it was not, its recorded replies are what counts.
    """

    record: CycleRecord
    stages: tuple[StageReplay, ...]
    not_reached: dict[str, str]
    chained: bool
    changed: tuple[Changed, ...] = ()
    replies: tuple[ModelReply, ...] | None = None

    @property
    def equal(self) -> bool:
        """True when no stage differs; without grasps to compare this proves nothing, see `grasps`."""
        return not any(stage.differences for stage in self.stages)

    @property
    def grasps(self) -> int:
        """Number of grasps in the recording; without any, its replay proves nothing."""
        detect = self.record.stages.get("detect")
        return len(detect.result.grasps) if detect is not None and isinstance(detect.result, Detections) else 0


def _recorded_models(station: Station, record: CycleRecord) -> Models:
    return replayed_models(station, record.last_replies)


def _live_models(station: Station, _record: CycleRecord) -> Models:
    return open_models(station, os.environ)


@dataclass(frozen=True)
class Request:
    """The stages to rerun, and how.

    Attributes:
        start: chained, from this stage on. ``only``: this stage alone. Neither: all, isolated - or chained from the
            first
            when ``overrides`` change the settings ("what if?").
        models: opens the models, a function of a module; by default they answer with the recorded replies.
    """

    overrides: tuple[str, ...] = ()
    start: StageName | None = None
    only: StageName | None = None
    models: ModelsOf = _recorded_models

    @classmethod
    def of(cls, overrides: Iterable[str], start: str | None, only: str | None, *, live_models: bool = False) -> Request:
        """Return the request of a command line. Raises: ConfigError for a stage that is not pure."""
        for name in (start, only):
            if name is not None and name not in PURE:
                raise ConfigError(f"The stage {name!r} cannot be run again.", f"Pure stages: {', '.join(PURE)}.")
        models = _live_models if live_models else _recorded_models
        return cls(tuple(overrides), cast(StageName | None, start), cast(StageName | None, only), models)

    @property
    def chained(self) -> bool:
        """True when the output of a stage is the input of the next."""
        return self.only is None and (self.start is not None or bool(self.overrides))


def replay(record: CycleRecord, request: Request, robot_of: Callable[[Station], Robot] = Robot) -> Replay:
    """Replay one recording.

    Args:
        robot_of: builds the planning model of a station, which takes a second; it may cache it for many recordings.

    Raises: StageNotReached when it holds none of the requested pure stages; PicturesTrimmed; NotHere when a package or
        file that it was made with is not on this machine; ConfigError for a bad override.
    """
    if record.trimmed:
        raise PicturesTrimmed(
            f"The pictures of {record.cycle_id} were {record.trimmed}: no stage can run again.",
            "Replay the whole recording, if there is one; recording.thin_after_days says when they are trimmed.",
        )
    station = recorded_station(record, request.overrides)
    not_reached, replies = dict[str, str](), list[ModelReply]()
    with opening(record, is_changed=bool(request.overrides)):
        robot, models = robot_of(station), request.models(station, record)
    try:
        run = _chained if request.chained else _isolated
        stages = tuple(run(_wanted(request), record, not_reached, _With(station, robot, models, replies.append)))
    finally:
        models.close()
    if not stages:
        recorded = ", ".join(name + _how_it_ended(one) for name, one in record.stages.items()) or "none"
        raise StageNotReached(
            f"The recording of {record.cycle_id} holds no stage that can be replayed.",
            f"Stages recorded: {recorded}. What a stop, the job's time or a fault ended is not compared.",
        )
    changed = tuple(_changed(record, station, request))
    is_asked = request.models is not _recorded_models or not is_replayed(station.perception.model, record.last_replies)
    asked = tuple(replies) if is_asked and any(one.stage == "detect" for one in stages) else None
    return Replay(record, stages, not_reached, request.chained, changed, asked)


def _changed(record: CycleRecord, station: Station, request: Request) -> Iterator[Changed]:
    before = recorded_station(record).model_dump(mode="json")
    now = station.model_dump(mode="json")
    for key in dict.fromkeys(override.partition("=")[0].strip() for override in request.overrides):
        yield Changed(key, value_at(before, key), value_at(now, key))


def _wanted(request: Request) -> list[Stage]:
    pure = [stage for stage in STAGES if stage.pure]
    if request.only is not None:
        return [stage for stage in pure if stage.name == request.only]
    return pure if request.start is None else pure[PURE.index(request.start) :]


class _With(NamedTuple):
    """Inputs of the stages that run again, and who hears each call of a goal-image model."""

    station: Station
    robot: Robot
    models: Models
    on_reply: OnReply


def _isolated(wanted: list[Stage], record: CycleRecord, _: dict[str, str], made_of: _With) -> Iterator[StageReplay]:
    for stage in wanted:
        if stage.name in record.stages and not _ended_from_outside(record.stages[stage.name]):
            yield _compared(stage, record, _rerun(stage, record, made_of))


def _ended_from_outside(recorded: StageRecord[Any]) -> bool:
    """True when a stop, the job's end or a fault ended the stage: no outcome of its inputs, which a rerun gives."""
    return recorded.failure is not None and recorded.failure.code in FROM_OUTSIDE


def _how_it_ended(recorded: StageRecord[Any]) -> str:
    return f" ({recorded.failure.code})" if recorded.failure is not None else ""


def _chained(
    wanted: list[Stage], record: CycleRecord, not_reached: dict[str, str], made_of: _With
) -> Iterator[StageReplay]:
    flowing, why = record, ""
    for stage in wanted:
        why = why or _unreachable(stage, record, flowing)
        if why:
            not_reached[stage.name] = why
            continue
        outcome = _rerun(stage, flowing, made_of)
        yield _compared(stage, record, outcome)
        flowing = _with(flowing, stage, outcome)
        why = f"{stage.name} ends it: {outcome.code}" if isinstance(outcome, Failure) else ""


def _unreachable(stage: Stage, record: CycleRecord, flowing: CycleRecord) -> str:
    """Why ``stage`` cannot be chained: its input is an execution, and that was of another plan."""
    if stage.name != "verify":
        return ""
    if "execute" not in record.stages:
        return "nothing was executed"
    before, now = (one.stages["plan"].result if "plan" in one.stages else None for one in (record, flowing))
    plan = next(stage for stage in STAGES if stage.name == "plan")
    same = isinstance(before, PickPlan) and isinstance(now, PickPlan) and not compare(before, now, plan.tolerances)
    return "" if same else "another plan was executed"


def _with(record: CycleRecord, stage: Stage, outcome: Message) -> CycleRecord:
    """The record with ``outcome`` as the output of ``stage``."""
    failed = isinstance(outcome, Failure)
    said = stage.topic.says(
        cycle_id=record.cycle_id,
        stage=stage.name,
        started_ns=0,
        duration_s=0.0,
        result=None if failed else outcome,
        failure=outcome if failed else None,
    )
    return replace(record, stages={**record.stages, stage.name: said})


def _compared(stage: Stage, record: CycleRecord, outcome: Message) -> StageReplay:
    if stage.name not in record.stages:
        ended = Difference("reached", False, True, None, 0.0, "")
        return StageReplay(stage.name, None, outcome, ((stage.name, ended),))
    said = record.stages[stage.name]
    recorded = said.result if said.result is not None else said.failure
    if recorded is None:
        raise RecordingError("A recorded stage holds neither a result nor a failure.", "The recording is damaged.")
    found = [(stage.step_of(one.field), one) for one in compare(recorded, outcome, stage.tolerances)]
    order = [step for step, _ in stage.steps]
    found.sort(key=lambda pair: order.index(pair[0]) if pair[0] in order else -1)
    return StageReplay(stage.name, recorded, outcome, tuple(found))


def _rerun(stage: Stage, record: CycleRecord, made_of: _With) -> Message:
    """The stage's result, or the failure it ends with: both are compared."""
    assert stage.rerun is not None
    try:
        return stage.rerun(record, made_of.station, made_of.robot, made_of.models, made_of.on_reply)
    except CycleFailure as failure:
        return Failure.of(failure)
