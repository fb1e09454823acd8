"""Replays all recordings below a folder, and summarizes: how many are equal, and the others' first differences."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bus.errors import CellError, PicturesTrimmed, RecordingError
from cell.replay.replay import Replay, Request, replay
from cell.replay.view import to_json, verdict
from config.load import station_hash
from config.schema import Station
from logs.mcap.names import found_below, shown, telling
from logs.mcap.reader import read_cycle
from planning.robot import Robot


class Tally:
    """The outcomes of the recordings of one folder."""

    def __init__(self) -> None:
        self.verdicts: Counter[str] = Counter()
        self.stages: Counter[str] = Counter()
        self.fields: Counter[str] = Counter()
        self.different: list[dict[str, Any]] = []
        self.unreadable: dict[str, str] = {}

    def add(self, path: Path, outcome: Replay | CellError) -> str:
        """Count one recording; return its verdict."""
        if isinstance(outcome, PicturesTrimmed):
            self.verdicts["trimmed"] += 1
            return "trimmed: not replayed"
        if isinstance(outcome, CellError):
            self.unreadable[shown(path)] = str(outcome)
            return "unreadable"
        said = verdict(outcome)
        self.verdicts[said] += 1
        for stage in outcome.stages:
            self.stages[stage.stage] += bool(stage.differences)
            fields = {f"{stage.stage}.{difference.field.partition('[')[0]}" for _, difference in stage.differences}
            self.fields.update(fields)
        if said == "different":
            self.different.append({"recording": shown(path), **to_json(outcome)})
        return said

    @property
    def exit_code(self) -> int:
        """0 equal, 1 different, 2 inconclusive: a recording is unreadable, or none holds a grasp to compare."""
        if self.verdicts["different"]:
            return 1
        return 2 if self.unreadable or not self.verdicts["equal"] else 0

    def to_json(self) -> dict[str, Any]:
        """The counts as a JSON object: recordings, and those in which each stage and each field differs."""
        return {
            "cycles": self.verdicts.total() + len(self.unreadable),
            **{said: self.verdicts[said] for said in ("equal", "different", "empty", "trimmed")},
            "unreadable": self.unreadable,
            "stages": dict(self.stages),
            "fields": dict(self.fields.most_common()),
            "differences": self.different,
        }


def replay_folder(folder: Path, request: Request, tell: Callable[[Path, str], None]) -> Tally:
    """Replay every closed recording below ``folder``; ``tell`` is called with each path and verdict.

    Raises: RecordingError when there is none.
    """
    paths = found_below(folder, "*.mcap")
    if not paths:
        raise RecordingError(f"There is no recording below {shown(folder)}.", "Name another folder, or a file.")
    robots: dict[str, Robot] = {}

    def robot_of(station: Station) -> Robot:
        key = station_hash(station.model_copy(update={"recording": type(station.recording)()}))
        return robots.get(key) or robots.setdefault(key, Robot(station))

    tally = Tally()
    for path in paths:
        outcome: Replay | CellError
        try:
            with telling(shown(path)):
                outcome = replay(read_cycle(path), request, robot_of)
        except CellError as error:
            outcome = error
        tell(path, tally.add(path, outcome))
    return tally
