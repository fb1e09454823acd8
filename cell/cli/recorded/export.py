"""``cell export lerobot`` and ``cell export grasps``: chosen recordings as data sets of other programs."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from bus.errors import RecordingError
from cell.cli.options import Config, Count, Json, Scheduler
from cell.cli.recorded.cycles import reading
from cell.cli.recorded.folders import Folder, InFolder, folder_of
from cell.terminal.drawing import tracked
from cell.terminal.printing import err, out
from cell.workers import ordered, workers_for
from config.load import DEFAULT_STATION
from logs.catalogue import open_catalogue
from logs.export import Done, Runner, Selection, export_grasps, export_lerobot, select
from logs.export.lerobot import MAX_FPS
from logs.mcap.names import shown

_SAID_EVERY_S = 10.0

export = typer.Typer(
    help="Chosen recordings as a data set of another program.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)

Output = Annotated[Path, typer.Option("--output", "-o", help="Folder of the data set; it must not exist.")]
Where = Annotated[
    str, typer.Option(metavar="SQL", help="Only these cycles: a condition of columns of `cycles` (docs/catalogue.md).")
]


@export.callback()
def _group() -> None: ...


@export.command()
def lerobot(
    output: Output,
    also: Folder = None,
    folder: InFolder = None,
    where: Where = "",
    fps: Annotated[int, typer.Option(min=1, max=MAX_FPS, help="Frames a second.")] = 10,
    workers: Count = None,
    scheduler: Scheduler = "",
    config: Config = DEFAULT_STATION,
    as_json: Json = False,
) -> None:
    """A LeRobot data set (version 3.0): joints, commands, both cameras, outcome and task; one episode a cycle.

    Exit 0 all chosen recordings are in it, or lack what an episode needs; 2 one cannot be read, or nothing is written.
    """
    selection, run = _selected(folder_of(config, folder, also), where, workers, scheduler)
    _tell(export_lerobot(selection, output, _progress, fps=fps, run=run), as_json)


@export.command()
def grasps(
    output: Output,
    also: Folder = None,
    folder: InFolder = None,
    where: Where = "",
    workers: Count = None,
    scheduler: Scheduler = "",
    config: Config = DEFAULT_STATION,
    as_json: Json = False,
) -> None:
    """Grasps: rectangles and poses with score and outcome (Parquet), and the pictures they were found in (PNG).

    Exit 0 all chosen recordings are in it, or have no grasp; 2 one cannot be read, or nothing is written.
    """
    selection, run = _selected(folder_of(config, folder, also), where, workers, scheduler)
    _tell(export_grasps(selection, output, _progress, run), as_json)


def _selected(root: Path, where: str, count: int | None, scheduler: str) -> tuple[Selection, Runner]:
    with open_catalogue(root.absolute() if scheduler else root, reading, err.line) as catalogue:
        selection = select(catalogue, where)
    return selection, partial(ordered, workers_for(len(selection.paths), count, scheduler))


def _progress(paths: Iterable[Path], total: int) -> Iterator[Path]:
    """A progress bar, or a line from time to time where there is no terminal."""
    said_s = time.monotonic()
    for number, path in enumerate(tracked(paths, total, f"exporting {total} recordings", err)):
        if not err.isatty() and time.monotonic() - said_s > _SAID_EVERY_S:
            said_s = time.monotonic()
            err.line(f"{number} of {total} recordings")
        yield path


def _tell(done: Done, as_json: bool) -> None:
    for one in done.left_out:
        err.line(f"{'DAMAGED' if one.is_damaged else 'left out'} {shown(one.path)}: {one.why}")
    if as_json:
        out.json(done.to_json())
    else:
        out.line(f"{shown(done.target)}: " + ", ".join(f"{count} {name}" for name, count in done.counts.items()))
    if any(one.is_damaged for one in done.left_out):
        raise typer.Exit(RecordingError.exit_code)
