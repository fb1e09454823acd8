"""``cell compare``: two cycles stage by stage, or two folders of them with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Annotated

import typer

from bus.errors import ConfigError
from cell.cli.options import Config, Json
from cell.cli.recorded.cycles import WIDTH, reading
from cell.cli.recorded.folders import InFolder, find_cycle, is_all_of
from cell.cli.recorded.show import BAD, STYLE
from cell.terminal.drawing import console, table, words
from cell.terminal.printing import err, out
from config.load import DEFAULT_STATION
from logs.comparison.cycles import KINDS, Comparison, Row, compare_cycles
from logs.comparison.folders import Rate, Sides, Time, compare_folders
from logs.comparison.intervals import Interval
from logs.comparison.motion import MotionRow
from logs.mcap.reader import read_cycle
from logs.report.comparison_pages import write_cycles_page, write_folders_page
from logs.report.timeline import summarize

_FEW = 3
"""So many values that only one cycle has are still listed one by one."""

One = Annotated[str, typer.Argument(metavar="A", help="A recording, a cycle's id, or a folder: what it was.")]
Other = Annotated[str, typer.Argument(metavar="B", help="The same of what it is compared with: what it is now.")]


def compare(
    a: One,
    b: Other,
    folder: InFolder = None,
    config: Config = DEFAULT_STATION,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Also write an HTML page.")] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="Also what differs by less than a second run of the same would.")
    ] = False,
    day: Annotated[str, typer.Option(help="Of two folders: only this day (UTC): 2026-11-28, 2026-11.")] = "",
    as_json: Json = False,
) -> None:
    """Compare two cycles stage by stage: input, decision, outcome; or two folders, by code and object (95 %)."""
    are_folders = is_all_of(a, folder), is_all_of(b, folder)
    for name, is_one in zip((a, b), are_folders, strict=True):
        if any(are_folders) and not is_one and not Path(name).exists():
            raise ConfigError(f"There is no folder {name}.", "Name two cycles, or two folders.")
    if any(are_folders) and not all(are_folders):
        raise ConfigError("A cycle cannot be compared with a folder.", "Name two cycles, or two folders.")
    if all(are_folders):
        _compare_folders(Path(a), Path(b), day, output, as_json=as_json)
        return
    found = compare_cycles(*(read_cycle(find_cycle(name, config, folder)) for name in (a, b)), everything=everything)
    out.json(found.to_json()) if as_json else _show(found)
    if output is not None:
        err.line(str(write_cycles_page(found, output)))


def _show(found: Comparison) -> None:
    for side, record in (("A", found.a), ("B", found.b)):
        timeline = summarize(record)
        out.line(
            f"{side}  {record.cycle_id}  ", (timeline.title, STYLE.get(timeline.outcome, BAD)), f"  {timeline.why}"
        )
    counts = ", ".join(f"{found.count(kind)} of {kind}" for kind in KINDS)
    first = found.first
    out.line(f"{len(found.rows)} values differ: {counts}")
    if first is not None:
        out.line(("first ", "bold"), f"{first.kind} of {first.stage}: {first.name} {_pair(first)}")
    for (stage, kind), rows in groupby(found.rows, key=lambda row: (row.stage, row.kind)):
        _show_rows(stage, kind, list(rows))
    for line in _motion(found.motion):
        out.line(line)


def _show_rows(stage: str, kind: str, rows: Sequence[Row]) -> None:
    label = f"{stage:<8} {kind:<9}"
    lacking = "B" if all(row.a is not None and row.b is None for row in rows) else ""
    lacking = "A" if all(row.a is None and row.b is not None for row in rows) else lacking
    if lacking and len(rows) > _FEW:
        out.line(f"{label} {len(rows)} values that {lacking} lacks: it did not come so far")
        return
    for row in rows:
        out.line(f"{label} {row.name:<22} {_pair(row)}")


def _pair(row: Row) -> str:
    return f"{_shown(row.a)} -> {_shown(row.b)} {row.unit}".rstrip()


def _shown(value: object) -> str:
    if value is None or value == "":
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _motion(rows: Sequence[MotionRow]) -> list[str]:
    """A line a segment; of several of one name that follow each other, the one with the largest difference of load."""
    lines = []
    for name, some in groupby(rows, key=lambda row: row.segment.partition(" ")[0]):
        same = list(some)
        most = max(same, key=lambda row: row.torque_nm)
        times = f" (the farthest apart of {len(same)})" if len(same) > 1 else ""
        lines.append(f"motion   {name:<9} {most.in_words()}{times}")
    return lines


# --- folders ----------------------------------------------------------------------------------------------------------


def _compare_folders(a: Path, b: Path, day: str, output: Path | None, *, as_json: bool) -> None:
    found = compare_folders(a, b, day, reading, err.line)
    out.json(found.to_json()) if as_json else _show_sides(found)
    if output is not None:
        err.line(str(write_folders_page(found, (str(a), str(b)), output)))


def _show_sides(found: Sides) -> None:
    out.line((found.answer, "bold"))
    columns = ("", "A", "B", "B - A, 95 %", "")
    rows = table(columns, right=columns[1:4])
    for of, rates in (("", [found.success, found.held]), ("code ", found.codes), ("success with ", found.objects)):
        for one in rates:
            rows.add_row(*map(words, _cells(of, one)))
    for time in found.times:
        rows.add_row(*map(words, _time_cells(time)))
    console(out, None if out.isatty() else WIDTH).print(rows)
    out.line("Each interval by itself holds the truth in 95 of 100 trials: of twenty rows, one marked * is luck.")


def _cells(of: str, one: Rate) -> tuple[str, ...]:
    sides = (f"{_percent(found)}  {n}/{m}" for found, (n, m) in ((one.rate_a, one.a), (one.rate_b, one.b)))
    return (f"{of}{one.name or 'not named'}", *sides, *_difference(one.difference, 100, ".1f"))


def _percent(found: Interval | None) -> str:
    return "-" if found is None else f"{found.value * 100:.1f} % ({found.low * 100:.1f}-{found.high * 100:.1f})"


def _time_cells(one: Time) -> tuple[str, ...]:
    medians = ("-" if value is None else f"{value:.3f} s" for value in (one.a_s, one.b_s))
    return (f"median {one.name}", *medians, *_difference(one.difference, 1, ".3f"))


def _difference(found: Interval | None, times: float, form: str) -> tuple[str, str]:
    if found is None:
        return "-", ""
    value, low, high = (f"{bound * times:+{form}}" for bound in found)
    return f"{value} ({low} to {high})", "*" if found.excludes_zero else ""
