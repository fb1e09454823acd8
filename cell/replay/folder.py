"""Replays all recordings below a folder, and summarizes: how many are equal, and the others' first differences."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from bus.errors import CellError, ConfigError, NotHere, PicturesTrimmed, RecordingError, StageNotReached
from cell.replay.replay import Replay, Request, replay
from cell.replay.view import EMPTY, to_json, verdict
from cell.workers import LocalWorkers, WorkerLost, Workers, in_order
from config.load import station_hash
from config.schema import Station
from logs.mcap.names import found_below, shown, telling
from logs.mcap.reader import read_cycle
from planning.robot import Robot

TRIMMED = "trimmed"
"""The pictures of the recording were taken out: nothing can be run again."""
NOT_HERE = "not here"
"""It can be read, and not be run again: a package or file that it needs is not here, or a setting is wrong."""


@dataclass(frozen=True)
class Judged:
    """The outcome of one recording, small enough to travel between processes.

    Attributes:
        verdict: of `cell.replay.view.verdict` (`EMPTY` also of a cycle that ended before the stages asked for),
            `TRIMMED`, `NOT_HERE` or ``unreadable``.
        error: why it was not replayed, or "".
        stages: rerun, each with whether it differs. ``fields``: those that differ. ``said``: of `to_json` if different.
    """

    path: Path
    verdict: str
    error: str = ""
    stages: tuple[tuple[str, bool], ...] = ()
    fields: tuple[str, ...] = ()
    said: dict[str, Any] | None = None

    @property
    def in_words(self) -> str:
        """The verdict for a person."""
        return f"{self.verdict}: not replayed" if self.verdict in (TRIMMED, NOT_HERE) else self.verdict


class Tally:
    """The outcomes of the recordings of one folder."""

    def __init__(self) -> None:
        self.verdicts: Counter[str] = Counter()
        self.stages: Counter[str] = Counter()
        self.fields: Counter[str] = Counter()
        self.different: list[dict[str, Any]] = []
        self.unreadable: dict[str, str] = {}
        self.not_here: dict[str, str] = {}

    def add(self, judged: Judged) -> None:
        """Count one recording."""
        if judged.error and judged.verdict == "unreadable":
            self.unreadable[shown(judged.path)] = judged.error
            return
        if judged.verdict == NOT_HERE:
            self.not_here[shown(judged.path)] = judged.error
        self.verdicts[judged.verdict] += 1
        for stage, differs in judged.stages:
            self.stages[stage] += differs
        self.fields.update(judged.fields)
        if judged.said is not None:
            self.different.append({"recording": shown(judged.path), **judged.said})

    @property
    def exit_code(self) -> int:
        """0 equal, 1 different, 2 inconclusive: one is unreadable or not to be run here, or none holds a grasp."""
        if self.verdicts["different"]:
            return 1
        return 2 if self.unreadable or self.not_here or not self.verdicts["equal"] else 0

    def to_json(self) -> dict[str, Any]:
        """Return the counts as a JSON object: recordings, and those in which each stage and each field differs."""
        return {
            "cycles": self.verdicts.total() + len(self.unreadable),
            **{said: self.verdicts[said] for said in ("equal", "different", "empty", "trimmed")},
            "not_here": self.not_here,
            "unreadable": self.unreadable,
            "stages": dict(self.stages),
            "fields": dict(self.fields.most_common()),
            "differences": self.different,
        }


def recordings_below(folder: Path) -> list[Path]:
    """Every closed recording below ``folder``, sorted. Raises: RecordingError when there is none."""
    paths = found_below(folder, "*.mcap")
    if not paths:
        raise RecordingError(f"There is no recording below {shown(folder)}.", "Name another folder, or a file.")
    return paths


def replay_folder(
    folder: Path, request: Request, tell: Callable[[Path, str], None], workers: Workers | None = None
) -> Tally:
    """Replay every closed recording below ``folder``.

    Args:
        tell: called with each path and verdict, in the order of the paths.
        workers: who replays; None = this process. The tally is the same whoever does.

    Raises: RecordingError when there is none; what `cell.workers.Workers.run` raises.
    """
    paths = recordings_below(folder)
    tally = Tally()
    for judged in judgements(paths, request, workers or LocalWorkers(1)):
        tally.add(judged)
        tell(judged.path, judged.in_words)
    return tally


def judgements(paths: list[Path], request: Request, workers: Workers) -> Iterator[Judged]:
    """Yield the outcome of each recording, in the order of the paths."""
    absolute = [path.absolute() for path in paths]  # of a worker elsewhere the working folder is another
    for index, found in in_order(workers.run(partial(judge, request=request), absolute)):
        if isinstance(found, WorkerLost):
            yield Judged(paths[index], "unreadable", str(found))
        else:
            yield Judged(paths[index], found.verdict, found.error, found.stages, found.fields, found.said)


def judge(path: Path, request: Request) -> Judged:
    """Replay one recording; what is wrong with it becomes part of the outcome."""
    try:
        with telling(shown(path)):
            outcome = replay(read_cycle(path), request, _robot_of)
    except PicturesTrimmed as error:
        return Judged(path, TRIMMED, str(error))
    except StageNotReached as error:
        return Judged(path, EMPTY, str(error))
    except (NotHere, ConfigError) as error:
        return Judged(path, NOT_HERE, str(error))
    except CellError as error:
        return Judged(path, "unreadable", str(error))
    return _judged(path, outcome)


def _judged(path: Path, outcome: Replay) -> Judged:
    said = verdict(outcome)
    fields = {
        f"{stage.stage}.{difference.field.partition('[')[0]}": None  # a set, in order
        for stage in outcome.stages
        for _, difference in stage.differences
    }
    stages = tuple((stage.stage, bool(stage.differences)) for stage in outcome.stages)
    return Judged(path, said, "", stages, tuple(fields), to_json(outcome) if said == "different" else None)


_robots: dict[str, Robot] = {}
"""The planning models of this process, by the configuration they are made of: each takes a second."""


def _robot_of(station: Station) -> Robot:
    key = station_hash(station.model_copy(update={"recording": type(station.recording)()}))
    return _robots.get(key) or _robots.setdefault(key, Robot(station))
