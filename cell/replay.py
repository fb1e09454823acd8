"""Runs the pure stages of a recorded cycle again, from their recorded inputs, and names the first difference."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from bus.codes import Code
from bus.errors import CycleFailure, RecordingError
from bus.frozen import Message
from bus.messages import Failure, StageRecord
from cell.stages import STAGES, Stage
from config.load import station_from
from config.schema import Station
from logs.compare import Difference, compare
from logs.reader import CycleRecord, read_cycle
from planning.robot import Robot


@dataclass(frozen=True)
class StageReplay:
    """One stage, run again; ``differences`` in field order."""

    stage: str
    differences: tuple[Difference, ...]


@dataclass(frozen=True)
class Replay:
    """A cycle, run again."""

    cycle_id: str
    stages: tuple[StageReplay, ...]

    @property
    def equal(self) -> bool:
        return not any(stage.differences for stage in self.stages)

    def to_json(self) -> dict[str, Any]:
        """``{"equal", "cycle_id", "stages": {stage: count}, "first_difference"?}``."""
        report: dict[str, Any] = {
            "equal": self.equal,
            "cycle_id": self.cycle_id,
            "stages": {stage.stage: len(stage.differences) for stage in self.stages},
        }
        for stage in self.stages:
            if stage.differences:
                report["first_difference"] = {"stage": stage.stage, **stage.differences[0].to_json()}
                break
        return report

    def show(self, out: Console) -> None:
        """The same for a person."""
        for stage in self.stages:
            verdict = f"[red]{len(stage.differences)} differences[/]" if stage.differences else "[green]equal[/]"
            out.print(f"{stage.stage:<8} {verdict}")
            for difference in stage.differences[:5]:
                out.print(f"    {difference.describe()}")
        out.print(f"{self.cycle_id}: {'equal' if self.equal else 'different'}")


def replay_file(path: Path, overrides: Iterable[str] = ()) -> Replay:
    """Replay one recording, with settings changed by ``overrides`` ("what if?").

    Raises: RecordingError when it cannot be read or holds no pure stage; ConfigError for a bad override.
    """
    record = read_cycle(path)
    station = station_from(dict(record.station), overrides, source="the recorded station")
    robot = Robot(station)
    stages = tuple(
        StageReplay(stage.name, tuple(_differences(stage, record, station, robot)))
        for stage in STAGES
        if stage.pure and stage.name in record.stages and not _was_stopped(record.stages[stage.name])
    )
    if not stages:
        raise RecordingError(
            f"{path} holds no stage that can be replayed.", f"Stages recorded: {', '.join(record.stages) or 'none'}."
        )
    return Replay(record.cycle_id, stages)


def _differences(stage: Stage, record: CycleRecord, station: Station, robot: Robot) -> list[Difference]:
    recorded = record.stages[stage.name]
    return compare(_either(recorded.result, recorded.failure), _rerun(stage, record, station, robot), stage.tolerances)


def _was_stopped(recorded: StageRecord[Any]) -> bool:
    """A stop is no outcome of the stage's inputs: it would not come again."""
    return recorded.failure is not None and recorded.failure.code is Code.STOPPED


def _rerun(stage: Stage, record: CycleRecord, station: Station, robot: Robot) -> Message:
    """The stage's result, or the failure it ends with: both are outcomes to compare."""
    assert stage.rerun is not None
    try:
        return stage.rerun(record, station, robot)
    except CycleFailure as failure:
        return Failure(code=failure.failure, text=failure.text)


def _either(result: Message | None, failure: Failure | None) -> Message:
    outcome = result if result is not None else failure
    if outcome is None:
        raise RecordingError("A recorded stage holds neither a result nor a failure.", "The recording is damaged.")
    return outcome
