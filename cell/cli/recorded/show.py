"""``cell show``, ``report``, ``recover``: explain, report and recover recordings."""

from __future__ import annotations

import webbrowser
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import typer

from bus.distribution import OURS
from bus.errors import ConfigError, RecordingError
from bus.messages import Job
from cell.cli.options import Config, Count, Json, Scheduler
from cell.cli.recorded.folders import Cycle, InFolder, find_cycle, is_all_of, root_of_labels
from cell.terminal.drawing import tracked
from cell.terminal.printing import err, out
from cell.workers import workers_for
from config.job import set_by
from config.load import DEFAULT_STATION
from logs.catalogue.labels import Label, labels_of
from logs.mcap.names import is_folder
from logs.mcap.reader import CycleRecord, read_cycle
from logs.mcap.recover import Recovered, recover_leftovers
from logs.mcap.recover import recover as recover_file
from logs.report.cycle_report import configuration_changes, write_report
from logs.report.day_report import days, outdated, write_cycle, write_day
from logs.report.timeline import Timeline, summarize

STYLE = {"SUCCESS": "green", "EMPTY": "yellow", "UNFINISHED": "yellow", "INTERRUPTED": "yellow", "TORN": "yellow"}
BAD = "bold red"

# --- show -------------------------------------------------------------------------------------------------------------


def show(cycle: Cycle, folder: InFolder = None, config: Config = DEFAULT_STATION, as_json: Json = False) -> None:
    """Show why a cycle ended so: its result, what to do, its stages, what was changed for it."""
    path = find_cycle(cycle, config, folder)
    record = read_cycle(path)
    timeline = summarize(record)
    labels = labels_of(root_of_labels(path, config, folder), record.cycle_id)
    if as_json:
        out.json(_told(record, timeline, labels))
        return
    out.line((timeline.title, STYLE.get(timeline.outcome, BAD)), f": {timeline.why}")
    if timeline.advice:
        out.line(("  what to do  ", "bold"), timeline.advice)
    for line in timeline.stages:
        text = f"  {line.name:<8} {line.took_s:6.2f} s  {line.said}".rstrip()
        out.line(text, style="red" if line.failed else "")
    out.line(f"  machine     {' -> '.join(span.name for span in timeline.states) or 'said nothing'}")
    attempt, changes = record.attempt, configuration_changes(record.station)
    for key, here, default in changes:
        if not set_by(attempt.job, key):
            out.line(f"  changed     {key} = {here} (default {default})", style="dim")
    if attempt.asked_by:
        out.line(f"  asked by    {attempt.asked_by}")
    for asked in _asked(attempt.job):
        out.line(f"  {asked}")
    for key, here, _ in changes:
        if set_by(attempt.job, key):
            out.line(f"  by the job  {key} = {here}", style="dim")
    if attempt.number:
        out.line(f"  try {attempt.number + 1}, after {attempt.retry_of}")
    if record.result is not None and record.result.retried_as:
        out.line(f"  tried again as {record.result.retried_as}")
    for one in labels:
        out.line(f"  {one.in_words()}")
    if record.trimmed:
        out.line(f"  pictures    {record.trimmed}")
    out.line(f"  recording   {path}, made by {_made_by(record.metadata)}", style="dim")


def _made_by(metadata: Mapping[str, str]) -> str:
    """Return the version that made a recording, and its commit, where they are known: a wheel has no commit."""
    version, commit = metadata.get(OURS, ""), metadata.get("commit", "unknown")
    known = [f"version {version}" if version else "", f"commit {commit}" if commit != "unknown" else ""]
    return ", ".join(filter(None, known)) or "an unknown version"


def _asked(job: Job) -> Iterator[str]:
    """Yield what was asked for, where anything was."""
    if job.job_id:
        yield f"job         {job.job_id}"
    for name, asked in (("target", job.target), ("place", job.place)):
        if asked is not None:
            yield f"{name:<11} " + ", ".join(
                f"{key} {value}" for key, value in asked.model_dump(exclude_none=True).items()
            )
    hints = [f"{key} {value}" for key, value in job.grasp.model_dump(exclude_defaults=True).items()]
    if hints:
        yield f"{'grasp':<11} " + ", ".join(hints)


def _told(record: CycleRecord, timeline: Timeline, labels: Sequence[Label]) -> dict[str, Any]:
    job, changes = record.attempt.job, configuration_changes(record.station)
    return {
        "result": record.result.model_dump(mode="json") if record.result is not None else None,
        "why": timeline.why,
        "advice": timeline.advice,
        "stages": timeline.took_s,
        "said": {line.name: line.said for line in timeline.stages},
        "states": [span.name for span in timeline.states],
        "changed": {key: here for key, here, _ in changes if not set_by(job, key)},
        "changed_by_job": {key: here for key, here, _ in changes if set_by(job, key)},
        "asked_by": record.attempt.asked_by,
        "trimmed": record.trimmed,
        "labels": [one.model_dump() for one in labels],
        "metadata": record.metadata,
    }


# --- report -----------------------------------------------------------------------------------------------------------


def report(
    cycle: Annotated[
        str, typer.Argument(metavar="FILE|CYCLE|FOLDER", help="A recording, a cycle's id, or a folder of recordings.")
    ],
    in_folder: InFolder = None,
    config: Config = DEFAULT_STATION,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Where to write the page.")] = None,
    embed: Annotated[
        bool, typer.Option("--embed", help="Put the drawing library into the page, to send it: 5 MB more.")
    ] = False,
    open_it: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    workers: Count = None,
    scheduler: Scheduler = "",
) -> None:
    """Write one HTML page that explains a cycle; of a folder, a page per cycle and one a day.

    Exit 0 all pages are written, 2 a recording cannot be read: the day's page names it as DAMAGED.
    """
    folder = Path(cycle)
    if is_all_of(cycle, in_folder):
        if output is not None or embed:
            raise ConfigError("--output and --embed are of one page; those of a folder lie beside their recordings.")
        pages, damaged = _report_folder(folder, workers, scheduler)
    else:
        path, damaged = find_cycle(cycle, config, in_folder), {}
        pages = [write_report(read_cycle(path), output or path.with_suffix(".html"), embed=embed)]
    for page in pages:
        out.line(str(page))
    for path, why in damaged.items():
        err.line(f"DAMAGED {path}: {why}")
    if open_it and pages:
        webbrowser.open(pages[0].resolve().as_uri())
    if damaged:
        raise typer.Exit(RecordingError.exit_code)


def _report_folder(folder: Path, count: int | None, scheduler: str) -> tuple[list[Path], dict[Path, str]]:
    """Write missing and outdated pages; return the days' pages, newest first, and the failed recordings' reasons."""
    to_write = outdated(folder)
    absolute = [path.absolute() for path in to_write]  # of a worker elsewhere the working folder is another
    run = workers_for(len(to_write), count, scheduler).run(write_cycle, absolute if scheduler else to_write)
    written = {to_write[index]: str(why) for index, why in tracked(run, len(to_write), "writing pages", err)}
    damaged = {path: written[path] for path in to_write if written[path]}
    return [write_day(day, damaged) for day in days(folder)], damaged


# --- recover ----------------------------------------------------------------------------------------------------------


def recover(
    files: Annotated[
        list[Path], typer.Argument(help="Torn or damaged recordings (.mcap.part, .mcap), or folders of .mcap.part.")
    ],
    as_json: Json = False,
) -> None:
    """Make torn recordings whole. Exit 0 all that was flushed is kept, 1 something is lost, 2 cannot.

    A .part gets its final name; anything else is left as it is, beside a new NAME.recovered.mcap. Of a folder, every
    .part below it that is not being written.
    """
    lost, failed = False, None
    if not (all_done := list(chain.from_iterable(_recovered(file) for file in files))):
        err.line("Nothing is torn there.")
    for done in all_done:
        if isinstance(done, RecordingError):  # the others are still recovered
            err.line(f"{done.code}: {done}")
            failed = done
            continue
        out.json(done.to_json()) if as_json else out.line(done.line())
        lost = lost or done.lost
    if failed is not None or lost:
        raise typer.Exit(failed.exit_code if failed is not None else 1)


def _recovered(path: Path) -> Iterable[Recovered | RecordingError]:
    try:
        if is_folder(path):
            return recover_leftovers(path)
        return [recover_file(path)]
    except RecordingError as error:
        return [error]
