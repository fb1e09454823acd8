"""``cell cycles``, ``show``, ``report``, ``recover``: what was recorded, listed, told, as pages, and made whole."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table
from rich.text import Text

from bus.errors import ConfigError, RecordingError
from cell.options import Config, Json, out, print_json
from config.load import DEFAULT_STATION, load_station
from logs.days import days, outdated, write_cycle, write_day
from logs.index import Entry, Filter, find_recording, list_cycles
from logs.names import is_folder, shown
from logs.reader import CycleRecord, read_cycle
from logs.recover import recover as recover_file
from logs.report import configuration_changes, write_report
from logs.story import Story, tell

_progress = Console(stderr=True)
_STYLE = {"SUCCESS": "green", "EMPTY": "yellow", "UNFINISHED": "yellow", "INTERRUPTED": "yellow", "TORN": "yellow"}
_BAD = "bold red"
_WIDTH = 1000
"""Where no terminal says its own: nothing is cut."""

Cycle = Annotated[
    str, typer.Argument(metavar="FILE|CYCLE", help="A recording (.mcap), or a cycle's id or a part of it.")
]


def find_cycle(name: str, config: Path) -> Path:
    """The recording that a command's FILE|CYCLE means. Raises: RecordingError, ConfigError."""
    return find_recording(name, load_station(config).recording.folder)


# --- cycles -----------------------------------------------------------------------------------------------------------


def cycles(
    folder: Annotated[Path | None, typer.Argument(help="Recordings folder.")] = None,
    config: Config = DEFAULT_STATION,
    failed: Annotated[bool, typer.Option("--failed", help="Only what did not end in SUCCESS or EMPTY.")] = False,
    code: Annotated[str, typer.Option(help="Only cycles that ended with this code.")] = "",
    day: Annotated[str, typer.Option(help="Only this day (UTC): 2026-11-28, 2026-11, today.")] = "",
    last: Annotated[int | None, typer.Option(min=1, help="Only so many of the newest.")] = None,
    as_json: Json = False,
) -> None:
    """List recorded cycles, newest first."""
    wanted = Filter(failed=failed, code=code, day=day, last=last)
    entries = list_cycles(folder or load_station(config).recording.folder, wanted)
    if as_json:
        for entry in entries:
            print_json(entry.to_json())
        return
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("cycle", "result", "code", "object", "time", "try", "why"):
        table.add_column(name, no_wrap=True, justify="right" if name == "time" else "left")
    for entry in entries:
        table.add_row(*_cells(entry))
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = _WIDTH
    console.print(table if table.rows else "none")


def _cells(entry: Entry) -> tuple[Text, ...]:
    style = _STYLE.get(entry.result, _BAD)
    took = f"{entry.wall_s:.1f} s" if entry.wall_s is not None else ""
    tries = f"{entry.number + 1}{' ->' if entry.retried_as else ''}"
    texts = entry.cycle_id, entry.result, entry.code, entry.object, took, tries, entry.reason
    return tuple(Text(text, style if place in (1, 2) else "") for place, text in enumerate(texts))


# --- show -------------------------------------------------------------------------------------------------------------


def show(cycle: Cycle, config: Config = DEFAULT_STATION, as_json: Json = False) -> None:
    """Why a cycle ended so: its result, what to do, its stages, what was changed for it."""
    path = find_cycle(cycle, config)
    record = read_cycle(path)
    story = tell(record)
    if as_json:
        print_json(_told(record, story))
        return
    out.print(Text.assemble((story.title, _STYLE.get(story.outcome, _BAD)), f": {story.why}"))
    if story.advice:
        out.print(Text.assemble(("  what to do  ", "bold"), story.advice))
    for line in story.stages:
        out.print(Text(f"  {line.name:<8} {line.took_s:6.2f} s  {line.said}".rstrip(), "red" if line.failed else ""))
    out.print(Text(f"  machine     {' -> '.join(span.name for span in story.states) or 'said nothing'}"))
    for key, here, default in configuration_changes(record.station):
        out.print(Text(f"  changed     {key} = {here} (default {default})", "dim"))
    attempt = record.attempt
    if attempt.number:
        out.print(Text(f"  try {attempt.number + 1}, after {attempt.retry_of}"))
    if record.result is not None and record.result.retried_as:
        out.print(Text(f"  tried again as {record.result.retried_as}"))
    out.print(Text(f"  recording   {shown(path)}, made by {record.metadata.get('commit', 'an unknown commit')}", "dim"))


def _told(record: CycleRecord, story: Story) -> dict[str, Any]:
    return {
        "result": record.result.model_dump(mode="json") if record.result is not None else None,
        "why": story.why,
        "advice": story.advice,
        "stages": {line.name: line.took_s for line in story.stages},
        "said": {line.name: line.said for line in story.stages},
        "states": [span.name for span in story.states],
        "changed": {key: here for key, here, _ in configuration_changes(record.station)},
        "metadata": record.metadata,
    }


# --- report -----------------------------------------------------------------------------------------------------------


def report(
    cycle: Annotated[
        str, typer.Argument(metavar="FILE|CYCLE|FOLDER", help="A recording, a cycle's id, or a folder of recordings.")
    ],
    config: Config = DEFAULT_STATION,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Where to write the page.")] = None,
    open_it: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
) -> None:
    """Write one self-contained HTML page that explains a cycle; of a folder, a page per cycle and one a day.

    Exit 0 all pages are written, 2 a recording cannot be read: the day's page names it as DAMAGED.
    """
    folder = Path(cycle)
    if is_folder(folder):
        if output is not None:
            raise ConfigError("--output names one page; those of a folder lie beside their recordings.")
        pages, damaged = _report_folder(folder)
    else:
        path, damaged = find_cycle(cycle, config), {}
        pages = [write_report(read_cycle(path), output or path.with_suffix(".html"))]
    for page in pages:
        out.print(Text(shown(page)))
    for path, why in damaged.items():
        typer.echo(f"DAMAGED {shown(path)}: {why}", err=True)
    if open_it and pages:
        webbrowser.open(pages[0].resolve().as_uri())
    if damaged:
        raise typer.Exit(RecordingError.exit_code)


def _report_folder(folder: Path) -> tuple[list[Path], dict[Path, str]]:
    """Write what is missing or outdated; the pages of the days, newest first, and what has none, with the reason."""
    todo = outdated(folder)
    written = {
        path: write_cycle(path)
        for path in track(todo, "writing pages", console=_progress, disable=not todo, transient=True)
    }
    damaged = {path: why for path, why in written.items() if why}
    return [write_day(day, damaged) for day in days(folder)], damaged


# --- recover ----------------------------------------------------------------------------------------------------------


def recover(
    files: Annotated[list[Path], typer.Argument(help="Torn or damaged recordings (.mcap.part, .mcap).")],
    as_json: Json = False,
) -> None:
    """Make torn recordings whole. Exit 0 all that was flushed is kept, 1 something is lost, 2 cannot.

    A .part gets its final name; anything else is left as it is, beside a new NAME.recovered.mcap.
    """
    lost, failed = False, None
    for file in files:
        try:
            done = recover_file(file)
        except RecordingError as error:  # the others are recovered all the same
            typer.echo(f"{error.code}: {error}", err=True)
            failed = error
            continue
        print_json(done.to_json()) if as_json else out.print(done.line())
        lost = lost or done.lost
    if failed is not None or lost:
        raise typer.Exit(failed.exit_code if failed is not None else 1)
