"""The choice of the recordings that are exported, and why others are left out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypeVar

from bus.codec import Json
from bus.errors import CellError, RecordingError
from logs.catalogue import Catalogue
from logs.catalogue.ask import ask
from logs.mcap.names import shown

MAX_CYCLES = 10_000_000
_MAX_S = 60.0
_NOT_FINISHED = "not finished; `cell recover` makes it readable"

Progress = Callable[[Iterable[Path], int], Iterable[Path]]
"""Passes the recordings on, of so many; it may show how far it is."""


ResultT = TypeVar("ResultT")
Work = Callable[[Path], "ResultT | RecordingError"]
"""The work on one recording, in this process or in another; an error is a result, too."""


class Runner(Protocol):
    """Whoever does the work on the recordings, for example several processes."""

    def __call__(self, work: Work[ResultT], paths: Sequence[Path]) -> Iterator[ResultT | CellError]:
        """Yield the results, in the order of the paths; the error of what its worker did not survive."""
        ...


def alone(work: Work[ResultT], paths: Sequence[Path]) -> Iterator[ResultT | CellError]:
    """Yield the results of this process, one after the other."""
    return map(work, paths)


def readable(work: Callable[[Path], ResultT], path: Path) -> ResultT | RecordingError:
    """Return the result of the work, or the error of a recording that cannot be read or lacks what is needed."""
    try:
        return work(path)
    except RecordingError as error:
        return error


class NothingToExport(RecordingError):
    """A recording lacks what the data set is made of; it can be read."""


@dataclass(frozen=True)
class LeftOut:
    """A recording that is not in the data set. ``is_damaged``: it cannot be read, else it has nothing to export."""

    path: Path
    why: str
    is_damaged: bool

    def to_json(self) -> Json:
        """Return the fields as a JSON object."""
        return {"recording": shown(self.path), "why": self.why, "is_damaged": self.is_damaged}


@dataclass
class Selection:
    """The recordings to export, oldest first, and what was left out so far. ``root``: the folder of recordings."""

    paths: list[Path]
    root: Path
    left_out: list[LeftOut] = field(default_factory=list)

    def done(self, work: Work[ResultT], run: Runner, progress: Progress) -> Iterator[tuple[Path, ResultT]]:
        """Each recording with its result, in order; one without is left out."""
        for path, found in zip(progress(self.paths, len(self.paths)), run(work, self.paths), strict=False):
            if isinstance(found, CellError):
                self.leave_out(path, found)
            else:
                yield path, found

    def leave_out(self, path: Path, error: CellError) -> None:
        """Leave out a recording, because of an error."""
        why = error.text.removeprefix(f"{shown(path)} ")
        self.left_out.append(LeftOut(path, why, not isinstance(error, NothingToExport)))

    def nothing(self) -> NothingToExport:
        """Return the error for a data set without any content: why the first recording is not in it."""
        paths = {*self.paths}
        first = next(one for one in self.left_out if one.path in paths)
        return NothingToExport(f"None of {len(paths)} recordings can be exported; {shown(first.path)}: {first.why}")


@dataclass(frozen=True)
class Done:
    """The result of an export.

    Attributes:
        target: its folder. ``counts``: of what it holds. ``recordings_bytes``: size of the recordings it was made of.
        left_out: chosen recordings that are not in it.
    """

    target: Path
    counts: dict[str, int]
    recordings_bytes: int
    left_out: tuple[LeftOut, ...]

    def to_json(self) -> Json:
        """Return the fields as a JSON object."""
        said: dict[str, Any] = {"target": shown(self.target), **self.counts, "bytes": self.recordings_bytes}
        return {**said, "left_out": [one.to_json() for one in self.left_out]}


def select(catalogue: Catalogue, where: str = "") -> Selection:
    """Return the recordings of an up-to-date catalogue that a condition in SQL chooses, oldest first.

    Args:
        where: of the columns of ``cycles`` (docs/catalogue.md), e.g. ``result = 'SUCCESS'``; "" chooses all.

    Raises: CatalogueError when the condition cannot be answered; RecordingError when no recording is chosen.
    """
    condition = f" WHERE ({where}\n)" if where else ""  # a comment in it ends with its line
    answer = ask(catalogue, f"SELECT name, file FROM cycles{condition}", max_rows=MAX_CYCLES, max_s=_MAX_S)
    below = f"{catalogue.below}/" if catalogue.below else ""
    files = sorted((name, file) for name, file in answer.rows if file.startswith(below))
    root = catalogue.store.root
    left_out = [LeftOut(root / file.path, _NOT_FINISHED, False) for file in catalogue.listed.torn]
    left_out += [LeftOut(root / file.path, "its name is not UTF-8", True) for file in catalogue.listed.nameless]
    if not files:
        which = f"where {where}" if where else "that is finished"
        raise RecordingError(f"There is no recorded cycle {which} in {shown(catalogue.folder)}.", "See `cell cycles`.")
    return Selection([root / file for _, file in files], root, left_out)
