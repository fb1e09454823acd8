"""``cell query``, ``label``, ``catalogue``: ask the catalogue of recorded cycles, label them, make it anew."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from bus.errors import ConfigError, RecordingError
from cell.cli.options import Config, Json
from cell.cli.recorded.cycles import WIDTH, reading
from cell.cli.recorded.folders import Cycle, Folder, InFolder, find_cycle, folder_of, root_of_labels
from cell.terminal.drawing import console, table, words
from cell.terminal.printing import err, out, plain
from cell.terminal.user import user_name
from config.load import DEFAULT_STATION
from logs.catalogue import open_catalogue
from logs.catalogue.ask import MAX_ROWS, MAX_S, Answer, ask
from logs.catalogue.export import csv_lines, write_parquet
from logs.catalogue.fleet import ask_fleet
from logs.catalogue.labels import WORDS, Label, append
from logs.mcap.index import read_entry
from logs.mcap.names import shown

# --- query ------------------------------------------------------------------------------------------------------------


def query(
    sql: Annotated[str, typer.Argument(metavar="SQL", help="One SELECT of cycles or labels.")],
    folder: InFolder = None,
    fleet: Annotated[
        list[Path] | None,
        typer.Option(
            help="Instead: Parquet exports of several cells, files or folders (vlad-cell[export]). Repeatable."
        ),
    ] = None,
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
    if fleet and folder is not None:
        raise ConfigError("--folder and --fleet exclude each other.", "Give one of them.")
    if fleet:
        answer = ask_fleet(fleet, sql, max_rows=max_rows, max_s=max_s)
    else:
        with open_catalogue(folder_of(config, folder), reading, err.line) as catalogue:
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
    console(out, None if out.isatty() else WIDTH).print(rows)


# --- label ------------------------------------------------------------------------------------------------------------


def label(
    cycle: Cycle,
    said: Annotated[list[str], typer.Argument(metavar="good|bad|NOTE", help="good or bad, a note, or both.")],
    who: Annotated[str, typer.Option(help="Who says so.", show_default="the user of this terminal")] = "",
    folder: InFolder = None,
    config: Config = DEFAULT_STATION,
    as_json: Json = False,
) -> None:
    """Say of a recorded cycle that it was good or bad, or note something; kept beside it."""
    path = find_cycle(cycle, config, folder)
    if not path.is_file():
        raise RecordingError(f"There is no recording {shown(path)}.", "See `cell cycles`.")
    word = said[0] if said[0] in WORDS else ""
    note = plain(" ".join(said[1:] if word else said)).strip()
    if not (word or note):
        raise ConfigError("The label says nothing.", "Say good, bad or a note.")
    made = Label.model_validate(
        {
            "cycle_id": read_entry(path).cycle_id,
            "at_ns": time.time_ns(),
            "who": plain(who or user_name()),
            "label": word,
            "note": note,
        }
    )
    append(root_of_labels(path, config, folder), made)
    out.json(made.model_dump()) if as_json else out.line(f"{made.cycle_id} {made.in_words()}")


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
    also: Folder = None,
    folder: InFolder = None,
    config: Config = DEFAULT_STATION,
    anew: Annotated[bool, typer.Option("--anew", help="Read all recordings again, not only what changed.")] = False,
    as_json: Json = False,
) -> None:
    """Check the catalogue, and read every recording that is new or has changed; a damaged catalogue is made anew."""
    began_s = time.monotonic()
    with open_catalogue(folder_of(config, folder, also), reading, err.line, thorough=True, anew=anew) as made:
        ((rows,),) = made.rows("SELECT count(*) FROM cycle")
        done = {"catalogue": str(made.store.path), "rows": rows, "read": made.made, "torn": len(made.listed.torn)}
    took_s = time.monotonic() - began_s
    if as_json:
        out.json(done | {"took_s": round(took_s, 2)})
    else:
        torn = f", {done['torn']} not finished (`cell recover`)" if done["torn"] else ""
        out.line(f"{done['catalogue']}: {rows} cycles, {done['read']} read in {took_s:.1f} s{torn}")
