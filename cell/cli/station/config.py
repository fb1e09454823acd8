"""``cell config``: a station file - what counts, what is wrong, what differs, and a new one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from bus.atomic import write_atomically
from bus.errors import ConfigError
from bus.lazy import LazyModule
from cell.cli.options import Config, Json, Set
from cell.terminal.printing import out
from config.json_schema import station_schema
from config.keys import nearest
from config.load import DEFAULT_STATION, load_station
from config.mistakes import mistakes_in
from config.new_station import Kind, cell_id_of, new_station
from config.origins import Setting, leaves, settings
from config.toml_file import read_text
from config.toml_text import toml_value
from config.undecided import undecided, undecided_in

plug_ins: Any = LazyModule("cell.cli.station.plug_in_mistakes")  # only `check` asks it; it brings OpenCV

config = typer.Typer(
    help="A station file: what counts and where it comes from, its mistakes, differences, a schema, a new one.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)
_ABSENT = "(not there)"


@config.command()
def show(
    section: Annotated[str, typer.Argument(help="Only this table or setting, like verify or sim.pace.")] = "",
    config: Config = DEFAULT_STATION,
    overrides: Set = None,
    changed: Annotated[bool, typer.Option("--changed", help="Only what the file or --set gives.")] = False,
    as_json: Json = False,
) -> None:
    """Print every setting as it counts, as TOML, and where it comes from: the file's line, --set, or the default."""
    station = load_station(config, overrides or [])
    if as_json and not section and not changed:
        out.json(station.model_dump_json(indent=2))
        return
    found = [
        one
        for one in settings(station, read_text(config), config.name, overrides or [])
        if _is_in(one.name, section) and not (changed and one.origin == "default")
    ]
    if section and not found and not changed:
        near = nearest(section.split("."))
        meant = f"Did you mean {near!r}? " if near else ""
        raise ConfigError(f"There is no setting {section!r}.", f"{meant}`cell config show` lists all of them.")
    if as_json:
        out.json({one.name: {"value": _plain(one.value), "origin": one.origin} for one in found})
        return
    _show(found)


def _is_in(name: str, section: str) -> bool:
    return not section or name == section or name.startswith(f"{section}.")


def _show(found: list[Setting]) -> None:
    """Print settings as TOML, each table once."""
    tables: dict[str, list[Setting]] = {}
    for one in found:
        tables.setdefault(one.name.rpartition(".")[0], []).append(one)
    for number, (table, rows) in enumerate(tables.items()):
        if number:
            out.line()
        if table:
            out.line(f"[{table}]")
        for one in rows:
            line = f"{'# ' if one.value is None else ''}{one.name.rpartition('.')[2]} = {toml_value(one.value)}"
            out.line(f"{line:<60}", (f"  # {one.origin}", "dim" if one.origin == "default" else ""))


def _plain(value: Any) -> Any:
    """A value as JSON has it."""
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if hasattr(value, "model_dump"):
        return value.model_dump(mode="json")
    return value if isinstance(value, str | int | float | bool | None) else str(value)


@config.command()
def check(
    files: Annotated[list[Path], typer.Argument(help="Station files.")],
    as_json: Json = False,
) -> None:
    """Name every mistake of station files: file and line, table, setting, what to do. Exit 0 none, 2 some.

    Drivers, detectors and models must be installed here, and say themselves which settings they have. What is wrong
    of several settings together may follow when each of them is right.
    What is still marked CHANGE or DECIDE is named, too; it is no mistake, and exits 0.
    Only the files are looked at; whether the devices are there says `cell doctor`.
    """
    count = 0
    for file in files:
        found = mistakes_in(file, plug_ins.plug_in_mistakes)
        count += len(found)
        for one in found:
            if as_json:
                out.json(one._asdict())
            else:
                out.line(str(one))
        if not found and not as_json:
            out.line(f"{file}: no mistakes")
        elif not as_json:
            out.line("Correct these, and check again: some mistakes of several settings together show only then.")
        if (left := undecided(file)) is not None:
            if as_json:
                out.json({"file": str(file), "undecided": undecided_in(file)})
            else:
                out.line(f"{left[0]}. {left[1]}")
    if count:
        raise typer.Exit(ConfigError.exit_code)


@config.command()
def diff(
    file: Annotated[Path, typer.Argument(metavar="A", help="Station file.")],
    other: Annotated[Path, typer.Argument(metavar="B", help="Another.")],
    as_json: Json = False,
) -> None:
    """Show what counts otherwise in B than in A, defaults included, however the files are written.

    Exit 0 nothing differs, 1 something does.
    """
    before, after = leaves(load_station(file)), leaves(load_station(other))
    names = [name for name in {**before, **after} if before.get(name, _ABSENT) != after.get(name, _ABSENT)]
    if as_json:
        out.json({name: {"a": _plain(before.get(name)), "b": _plain(after.get(name))} for name in names})
    elif not names:
        out.line("nothing differs")
    else:
        for name in names:
            out.line(f"{name:<36}  {_written(before, name)} -> {_written(after, name)}")
    if names:
        raise typer.Exit(1)


def _written(station: dict[str, Any], name: str) -> str:
    return toml_value(station[name]) if name in station else _ABSENT


@config.command()
def schema() -> None:
    """Print the JSON schema of a station file, for an editor: names are completed, mistakes marked, settings explained.

    Editors that know TOML (taplo; Even Better TOML) look for it where the file's first line says:
    #:schema ./station.schema.json
    """
    out.json(station_schema())


@config.command()
def new(
    file: Annotated[Path, typer.Argument(help="Station file to write; it must not be there yet.")],
    simulated: Annotated[bool, typer.Option("--simulated", help="Of a simulated cell, with objects of yours.")] = False,
    of_bin: Annotated[bool, typer.Option("--bin", help="Of a simulated cell with a bin full of objects.")] = False,
) -> None:
    """Write a commented station file with only what one must decide; what it leaves out has its default."""
    if file.exists():
        raise ConfigError(f"{file} is there already.", "Name another, or move it away first.")
    kind = Kind.BIN if of_bin else Kind.SIMULATED if simulated else Kind.ROBOT
    write_atomically(file, new_station(cell_id_of(file), kind).encode())
    todo = "go through the lines marked DECIDE, then cell config check" if undecided_in(file) else "cell start --config"
    out.line(f"{file}: {todo} {file}")
    if kind is not Kind.ROBOT:
        out.line(f"Every command for this cell takes --config {file}.")
