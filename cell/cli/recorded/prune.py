"""``cell prune``: make room among the recordings, as the daemon does between cycles; or only say what would go."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import typer

from bus.codec import Json as JsonObject
from bus.errors import CellError, RecordingError
from cell.cli.options import Config, Json, Set
from cell.cli.recorded.cycles import WIDTH
from cell.cli.recorded.folders import Folder, InFolder, folder_of
from cell.terminal.drawing import console, table, words
from cell.terminal.printing import err, out
from config.load import DEFAULT_STATION, load_station
from config.recording import RecordingSettings
from logs.mcap.names import shown
from logs.mcap.retention import GB, Due, Plan
from logs.prune import Done, Pruner, is_recording

_ACTS = {"delete": "deleted", "thin": "trimmed"}


def prune(
    also: Folder = None,
    folder: InFolder = None,
    config: Config = DEFAULT_STATION,
    overrides: Set = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only say what would go, why, and what it frees.")] = False,
    as_json: Json = False,
) -> None:
    """Trim and delete recordings by the rule of the station (recording.keep_gb and others), archived before.

    Refused while a cycle is recorded. What is open, unfinished, pinned or labelled stays, and so does the newest one.
    Exit 0 done, 1 something could not be trimmed or deleted, 2 refused.
    """
    settings = load_station(config, overrides or []).recording
    if folder is not None or also is not None:
        settings = settings.model_copy(update={"folder": folder_of(config, folder, also)})
    if not settings.rules:
        err.line("recordings are never deleted: recording.keep_gb, keep_free_gb, keep_days and the like are 0")
    pruner = Pruner(settings)
    plan = pruner.plan()
    if dry_run:
        _show(plan, as_json)
    elif not _prune(pruner, plan, settings, as_json):
        raise typer.Exit(1)


def _show(plan: Plan, as_json: bool) -> None:
    """Print what would go. A trimmed recording frees what is known only then."""
    if as_json:
        for one in (*plan.thin, *plan.delete):
            out.json(_to_json(one))
        return
    if plan.thin or plan.delete:
        rows = table(("cycle", "result", "would be", "by", "MB"), right=("MB",))
        for one in (*plan.thin, *plan.delete):
            size = f"{one.file.bytes / 1e6:.1f}" if one.act == "delete" else ""
            rows.add_row(*map(words, (one.file.path.stem, one.file.result, _ACTS[one.act], one.why, size)))
        console(out, None if out.isatty() else WIDTH).print(rows)
    freed_gb = sum(one.file.bytes for one in plan.delete) / GB
    out.line(f"{len(plan.delete)} would be deleted, {freed_gb:.2f} GB freed; {len(plan.thin)} would be trimmed")
    if plan.short:
        out.line(f"{plan.short} would not be met: what is left is pinned, labelled, open, or the newest one")


def _prune(pruner: Pruner, plan: Plan, settings: RecordingSettings, as_json: bool) -> bool:
    """Do it; False when something failed. Raises: RecordingError while a cycle is recorded, or another prunes."""
    with pruner.alone() as is_alone:
        if not is_alone:
            raise RecordingError(f"Another process prunes {shown(settings.folder)}.", "Wait until it is done.")
        trimmed = list(_each(pruner, plan.thin, settings.folder))
        if trimmed:
            plan = pruner.plan()  # what was gained by that need not be deleted
        outcomes = [*trimmed, *_each(pruner, plan.delete, settings.folder)]
    done = [one for one in outcomes if isinstance(one, Done)]
    if as_json:
        for one in done:
            out.json(_to_json(one.due) | {"freed_bytes": one.freed_bytes, "archived": one.archived})
    else:
        _sum_up(done)
    return len(done) == len(outcomes)


def _each(pruner: Pruner, due: Sequence[Due], root: Path) -> Iterator[Done | CellError]:
    """Do one after the other, between cycles. Raises: RecordingError when a cycle begins."""
    for one in due:
        if is_recording(root):
            raise RecordingError(
                "A cycle is being recorded.", "Wait for its end; the daemon prunes on its own between cycles."
            )
        try:
            done = pruner.do(one)
        except RecordingError as error:
            err.line(f"{error.code}: {error}")
            yield error
            continue
        if done is not None:
            yield done


def _sum_up(done: Sequence[Done]) -> None:
    for act, word in _ACTS.items():
        some = [one for one in done if one.due.act == act]
        copied = sum(bool(one.archived) for one in some)
        freed_gb = sum(one.freed_bytes for one in some) / GB
        out.line(f"{len(some)} {word}, {freed_gb:.2f} GB freed{f', {copied} archived' if copied else ''}")


def _to_json(due: Due) -> JsonObject:
    return {
        "recording": shown(due.file.path),
        "result": due.file.result,
        "act": _ACTS[due.act],
        "by": due.why,
        "bytes": due.file.bytes,
    }
