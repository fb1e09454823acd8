"""``cell cycles``: list recorded cycles, or sum them up."""

from __future__ import annotations

import difflib
import time
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from typing import Annotated

import typer

from bus.codes import Code
from bus.errors import ConfigError
from cell.cli.options import Config, Json
from cell.cli.recorded.folders import Folder, InFolder, folder_of
from cell.cli.recorded.show import BAD, STYLE
from cell.terminal.drawing import console, table, tracked, words
from cell.terminal.printing import Part, err, out, plain
from config.load import DEFAULT_STATION
from logs.catalogue import Catalogue, open_catalogue
from logs.catalogue.figures import DEFINITIONS, Counts, Summary, summed
from logs.catalogue.rows import File
from logs.mcap.index import Entry, Filter, day_named

WIDTH = 1000
"""Columns when no terminal reports its width: nothing is cut."""
_SAID_AFTER_S = 2.0
_COLUMNS = ("cycle", "result", "code", "object", "time", "try", "why")
_AT_ONCE = 500
"""Rows of the table, which says how wide its columns are; further ones are lines of the same widths."""


def cycles(
    also: Folder = None,
    folder: InFolder = None,
    config: Config = DEFAULT_STATION,
    failed: Annotated[bool, typer.Option("--failed", help="Only what did not end in SUCCESS or EMPTY.")] = False,
    code: Annotated[str, typer.Option(help="Only cycles that ended with this code.")] = "",
    day: Annotated[str, typer.Option(help="Only this day (UTC): 2026-11-28, 2026-11, today.")] = "",
    last: Annotated[int | None, typer.Option(min=1, help="Only so many of the newest.")] = None,
    summary: Annotated[
        bool, typer.Option("--summary", help="Picks an hour, rates, interventions, time lost; of each day, too.")
    ] = False,
    as_json: Json = False,
) -> None:
    """List recorded cycles, newest first, or sum them up."""
    if summary and (failed or code or last):
        raise ConfigError("--summary is of all cycles, or of those of one --day.", "Leave out the other options.")
    if code and code.upper() not in set(Code):
        near = difflib.get_close_matches(code.upper(), list(Code), n=1)
        meant = f"Did you mean {near[0]}? " if near else ""
        raise ConfigError(f"There is no code {code!r}.", f"{meant}docs/faults.md has all.")
    with open_catalogue(folder_of(config, folder, also), reading, err.line) as catalogue:
        if summary:
            _sum_up(summed(catalogue, day_named(day)), as_json)
        else:
            _list(catalogue, Filter(failed=failed, code=code, day=day, last=last), as_json)


def reading(files: Iterable[File], total: int) -> Iterator[File]:
    """Passes the recordings on that are read, with a progress bar, or a line where there is no terminal."""
    began_s, is_said = time.monotonic(), False
    for file in tracked(files, total, f"reading {total} recordings into the catalogue", err):
        yield file
        if not is_said and time.monotonic() - began_s > _SAID_AFTER_S and not err.isatty():
            is_said = True
            err.line(f"reading {total} recordings that the catalogue does not know yet")


def _list(catalogue: Catalogue, wanted: Filter, as_json: bool) -> None:
    entries = catalogue.entries(wanted)
    if as_json:
        for entry in entries:
            out.json(entry.to_json())
        return
    first = [_cells(entry) for entry in islice(entries, _AT_ONCE)]
    if not first:
        out.line("none")
        return
    rows = table(_COLUMNS, right=("time",))
    for cells in first:
        rows.add_row(*map(words, cells))
    screen = console(out, None if out.isatty() else WIDTH)
    screen.print(rows)
    widths = [max(len(title), *map(len, texts)) for title, texts in zip(_COLUMNS, _texts(first), strict=True)]
    for entry in entries:
        out.line(*_line(_cells(entry), widths, screen.width))


def _texts(rows: Sequence[Sequence[Part]]) -> list[list[str]]:
    """The texts of a table, column by column."""
    return [[part if isinstance(part, str) else part[0] for part in column] for column in zip(*rows, strict=True)]


def _line(cells: Sequence[Part], widths: Sequence[int], room: int) -> Iterator[Part]:
    """A further row below the first ones: a table of all of them would take a minute for a hundred thousand."""
    for cell, width in zip(cells, widths, strict=True):
        text, style = cell if isinstance(cell, tuple) else (cell, "")
        text = plain(text)
        is_last = room <= width or cell is cells[-1]
        yield text[:room] if is_last else f"{text:<{width}} ", style
        room -= width + 1
        if room <= 0:
            return


def _cells(entry: Entry) -> tuple[Part, ...]:
    style = STYLE.get(entry.result, BAD)
    took = f"{entry.wall_s:.1f} s" if entry.wall_s is not None else ""
    tries = f"{entry.number + 1}{' ->' if entry.retried_as else ''}"
    texts = entry.cycle_id, entry.result, entry.code, entry.went_for, took, tries, entry.reason
    return tuple((text, style if place in (1, 2) else "") for place, text in enumerate(texts))


# --- cycles --summary -------------------------------------------------------------------------------------------------


def _sum_up(summary: Summary, as_json: bool) -> None:
    if as_json:
        out.json(summary.to_json())
        return
    screen = console(out, None if out.isatty() else WIDTH)
    rows = table(("figure", "", "means"), right=("",))
    for name, value, meaning in _figures(summary.total):
        rows.add_row(*map(words, (name, value, meaning)))
    screen.print(rows)
    for code, lost_s in summary.total.to_json()["lost_s"].items():
        of = summary.total.codes[code]
        out.line(f"lost  {code or 'without a code'}: {lost_s:.1f} s in {of} cycle{'s' if of != 1 else ''}")
    if len(summary.days) > 1:
        _print_days(summary)


def _figures(counts: Counts) -> Iterator[tuple[str, str, str]]:
    said = counts.to_json()
    for name in ("picks", "picks_per_hour", "success", "cycles", "attempts_per_pick", "executed", "missed", "dropped",
                 "multi_pick", "infeasible"):  # fmt: skip
        yield name, _shown(name, said[name]), DEFINITIONS[name]
    stepped_in = ", ".join(str(value) for value in said["interventions"].values())
    yield "stops, aborts, holds", stepped_in, DEFINITIONS["stops, aborts, holds"]
    yield "picks_between_stops", _shown("", said["picks_between_stops"]), DEFINITIONS["picks_between_stops"]
    yield "lost_s", f"{sum(said['lost_s'].values()):.1f}", DEFINITIONS["lost_s"]


def _shown(name: str, value: float | None) -> str:
    if value is None:
        return "-"
    is_share = name in ("success", "missed", "dropped", "multi_pick", "infeasible")
    return f"{value * 100:.1f} %" if is_share else f"{value:g}"


def _print_days(summary: Summary) -> None:
    names = ("picks", "picks_per_hour", "success", "missed", "dropped", "infeasible", "attempts_per_pick")
    rows = table(("day", *names), right=names)
    for day, counts in summary.days.items():
        said = counts.to_json()
        rows.add_row(*map(words, (day, *(_shown(name, said[name]) for name in names))))
    console(out, None if out.isatty() else WIDTH).print(rows)
