"""``cell alike`` and ``groups``: the past cycles that are nearest to one, and failures in groups."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bus.errors import RecordingError
from cell.cli.options import Config, Json
from cell.cli.recorded.cycles import reading
from cell.cli.recorded.folders import Cycle, Folder, InFolder, find_cycle, folder_of, root_of_labels
from cell.cli.recorded.show import BAD, STYLE
from cell.terminal.printing import err, out
from config.load import DEFAULT_STATION
from logs.alike.features import Space, space
from logs.alike.groups import ALIKE, group_failures, nearest
from logs.catalogue import open_catalogue
from logs.mcap.index import read_entry

_FIRST = 5


def alike(
    cycle: Cycle,
    folder: InFolder = None,
    config: Config = DEFAULT_STATION,
    last: Annotated[int, typer.Option(min=1, help="So many of the nearest.")] = _FIRST,
    as_json: Json = False,
) -> None:
    """Show the past cycles nearest to one, by what was seen and what happened; 0 = no difference (docs/alike.md)."""
    path = find_cycle(cycle, config, folder)
    cycle_id = read_entry(path).cycle_id
    where = _space(folder or root_of_labels(path, config))
    try:
        found = nearest(where, cycle_id, last)
    except KeyError as error:
        raise RecordingError(
            f"The catalogue has no finished cycle {cycle_id}.", "Name another, or the folder it lies in (--folder)."
        ) from error
    for one in found:
        if as_json:
            out.json(one.to_json())
            continue
        row = one.row
        title = " ".join(part for part in (row["result"], row["code"], row["object"]) if part)
        said = f"  a person: {row['label']}" if row["label"] else ""
        out.line(f"{one.distance:.3f}  {one.cycle_id}  ", (title, STYLE.get(row["result"], BAD)), said)
        out.line(f"       {row['reason']}")
        out.line(f"       {one.in_words()}", style="dim")
    if not found and not as_json:
        out.line("none")


def groups(
    also: Folder = None,
    folder: InFolder = None,
    config: Config = DEFAULT_STATION,
    _failed: Annotated[bool, typer.Option("--failed", help="What FAILED or was ABORTED; nothing else is.")] = True,
    apart: Annotated[
        float, typer.Option("--apart", min=0.0, max=1.0, help="Groups are at least so far apart: 0..1.")
    ] = ALIKE,
    as_json: Json = False,
) -> None:
    """Failures in groups, the largest first: a sentence and three examples each (docs/alike.md)."""
    found = group_failures(_space(folder_of(config, folder, also)), apart)
    for one in found:
        if as_json:
            out.json(one.to_json())
            continue
        out.line((f"{len(one.cycles):>5}", "bold"), f"  {one.sentence}")
        out.line(f"       {'  '.join(one.examples)}", style="dim")
    if not found and not as_json:
        out.line("none failed")


def _space(folder: Path) -> Space:
    with open_catalogue(folder, reading, err.line) as catalogue:
        return space(catalogue)
