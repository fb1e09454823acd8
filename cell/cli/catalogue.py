"""``cell cycles``, ``query``, ``label``, ``catalogue``: list, sum up, ask and label recorded cycles."""

from __future__ import annotations

import getpass
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Annotated

import typer

from bus.errors import ConfigError
from cell.cli.options import Config, Json
from cell.cli.recordings import BAD, STYLE, Cycle, find_cycle, root_of_labels
from cell.terminal.drawing import console, table, tracked, words
from cell.terminal.printing import Part, err, out, plain
from config.load import DEFAULT_STATION, load_station
from logs.catalogue import Catalogue, open_catalogue
from logs.catalogue.ask import MAX_ROWS, MAX_S, Answer, ask
from logs.catalogue.export import csv_lines, write_parquet
from logs.catalogue.figures import DEFINITIONS, Counts, Summary, summed
from logs.catalogue.labels import WORDS, Label, append
from logs.catalogue.rows import File
from logs.mcap.index import Entry, Filter, read_entry

_WIDTH = 1000
"""Columns when no terminal reports its width: nothing is cut."""
_SAID_AFTER_S = 2.0
_COLUMNS = ("cycle", "result", "code", "object", "time", "try", "why")
_AT_ONCE = 500
"""Rows of the table, which says how wide its columns are; further ones are lines of the same widths."""

Folder = Annotated[Path | None, typer.Argument(help="Recordings folder.")]


# --- cycles -----------------------------------------------------------------------------------------------------------


def cycles(
    folder: Folder = None,
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
    with open_catalogue(folder or load_station(config).recording.folder, reading, err.line) as catalogue:
        if summary:
            _sum_up(summed(catalogue, f"{datetime.now(UTC):%Y-%m-%d}" if day == "today" else day), as_json)
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
    screen = console(out, None if out.isatty() else _WIDTH)
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
    texts = entry.cycle_id, entry.result, entry.code, entry.object, took, tries, entry.reason
    return tuple((text, style if place in (1, 2) else "") for place, text in enumerate(texts))


# --- cycles --summary -------------------------------------------------------------------------------------------------


def _sum_up(summary: Summary, as_json: bool) -> None:
    if as_json:
        out.json(summary.to_json())
        return
    screen = console(out, None if out.isatty() else _WIDTH)
    rows = table(("figure", "", "means"), right=("",))
    for name, value, meaning in _figures(summary.total):
        rows.add_row(*map(words, (name, value, meaning)))
    screen.print(rows)
    for code, lost_s in summary.total.to_json()["lost_s"].items():
        out.line(f"lost  {code or 'without a code'}: {lost_s:.1f} s in {summary.total.codes[code]} cycles")
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
    console(out, None if out.isatty() else _WIDTH).print(rows)


# --- query ------------------------------------------------------------------------------------------------------------


def query(
    sql: Annotated[str, typer.Argument(metavar="SQL", help="One SELECT of cycles or labels.")],
    folder: Annotated[Path | None, typer.Option("--folder", help="Recordings folder.")] = None,
    config: Config = DEFAULT_STATION,
    as_csv: Annotated[bool, typer.Option("--csv", help="Print CSV.")] = False,
    as_json: Json = False,
    to_parquet: Annotated[Path | None, typer.Option("--parquet", help="Write this file (vlad-cell[export]).")] = None,
    max_rows: Annotated[int, typer.Option("--rows", min=1, help="More rows than this are refused.")] = MAX_ROWS,
    max_s: Annotated[float, typer.Option("--seconds", min=0.01, max=3600, help="It may take so long [s].")] = MAX_S,
) -> None:
    """Ask the catalogue of recorded cycles in SQL; it can only be read (docs/catalogue.md)."""
    if as_csv + as_json + (to_parquet is not None) > 1:
        raise ConfigError("--csv, --json and --parquet exclude each other.", "Give one of them.")
    with open_catalogue(folder or load_station(config).recording.folder, reading, err.line) as catalogue:
        answer = ask(catalogue, sql, max_rows=max_rows, max_s=max_s)
    if to_parquet is not None:
        write_parquet(answer, to_parquet)
        out.line(f"{to_parquet}: {len(answer.rows)} rows")
    elif as_csv:
        for line in csv_lines(answer):
            out.line(line)
    elif as_json:
        for row in answer.rows:
            out.json({name: _as_json(value) for name, value in zip(answer.columns, row, strict=True)})
    else:
        _print(answer)


def _as_json(value: object) -> object:
    return value.hex() if isinstance(value, bytes) else value


def _print(answer: Answer) -> None:
    rows = table(answer.columns)
    for row in answer.rows:
        rows.add_row(*(words("" if value is None else str(value)) for value in row))
    console(out, None if out.isatty() else _WIDTH).print(rows)


# --- label ------------------------------------------------------------------------------------------------------------


def label(
    cycle: Cycle,
    said: Annotated[list[str], typer.Argument(metavar="good|bad|NOTE", help="good or bad, a note, or both.")],
    who: Annotated[str, typer.Option(help="Who says so.", show_default="the user of this terminal")] = "",
    config: Config = DEFAULT_STATION,
    as_json: Json = False,
) -> None:
    """Say of a recorded cycle that it was good or bad, or note something; kept beside it."""
    path = find_cycle(cycle, config)
    word = said[0] if said[0] in WORDS else ""
    made = Label.model_validate(
        {
            "cycle_id": read_entry(path).cycle_id,
            "at_ns": time.time_ns(),
            "who": who or _user(),
            "label": word,
            "note": " ".join(said[1:] if word else said),
        }
    )
    append(root_of_labels(path, config), made)
    out.json(made.model_dump()) if as_json else out.line(f"{made.cycle_id} {made.in_words()}")


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):  # a user id without a name
        return str(os.getuid())


# --- catalogue --------------------------------------------------------------------------------------------------------

catalogue = typer.Typer(
    help="The catalogue: one row a recorded cycle, made of the recordings.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)


@catalogue.callback()
def _group() -> None: ...


@catalogue.command()
def rebuild(
    folder: Folder = None,
    config: Config = DEFAULT_STATION,
    anew: Annotated[bool, typer.Option("--anew", help="Read all recordings again, not only what changed.")] = False,
    as_json: Json = False,
) -> None:
    """Check the catalogue, and read every recording that is new or has changed; a damaged catalogue is made anew."""
    began_s = time.monotonic()
    with open_catalogue(
        folder or load_station(config).recording.folder, reading, err.line, thorough=True, anew=anew
    ) as made:
        ((rows,),) = made.rows("SELECT count(*) FROM cycle")
        done = {"catalogue": str(made.store.path), "rows": rows, "read": made.made, "torn": len(made.listed.torn)}
    took_s = time.monotonic() - began_s
    if as_json:
        out.json(done | {"took_s": round(took_s, 2)})
    else:
        torn = f", {done['torn']} not finished (`cell recover`)" if done["torn"] else ""
        out.line(f"{done['catalogue']}: {rows} cycles, {done['read']} read in {took_s:.1f} s{torn}")
