"""``cell pick`` and ``cell run``: picks on a running cell, commanded and attended by this process to their end."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated

import typer

from bus.codes import title_of
from bus.commands import MAX_CYCLES, CellState, CommandReply, CommandRequest
from bus.errors import Refused
from bus.messages import CycleResult
from bus.messages.job import job_of
from cell import client
from cell.cli.options import Config, Json, Set, object_name_of
from cell.cli.picks.job_options import (
    BoxPx,
    ClearWay,
    DeadlineS,
    FromAbove,
    JobId,
    MaxForce,
    Pixel,
    PlaceAt,
    PointM,
    Queue,
    TargetText,
    place_of,
    target_of,
    wrong_option_named,
)
from cell.cli.picks.queued_job import QueuedJob
from cell.client import Client
from cell.daemon.batch import Batch
from cell.following import Following
from cell.machine.states import ENDED, told
from cell.terminal.printing import err, out
from config.load import DEFAULT_STATION, load_station

_PATIENCE_S = 600.0
_INTERRUPTED = 130
"""Exit code of a process that Ctrl-C ended, as a shell reports it."""
_FINE = ("SUCCESS", "EMPTY")
_ANSWERED_BY = "nothing moves until somebody answers: cell approve, cell next-grasp, cell reject, or the page"


def pick(
    config: Config = DEFAULT_STATION,
    object_name: Annotated[
        str | None, typer.Option("--object", help="Simulation: the object to present.", callback=object_name_of)
    ] = None,
    job_id: JobId = "",
    target: TargetText = None,
    pixel: Pixel = None,
    box: BoxPx = None,
    point: PointM = None,
    place: PlaceAt = None,
    deadline_s: DeadlineS = None,
    max_force: MaxForce = None,
    from_above: FromAbove = False,
    clear_way: ClearWay = False,
    queue: Queue = False,
    overrides: Set = None,
    as_json: Json = False,
) -> None:
    """Pick one object, and wait for the result. The cell must be Idle or Complete; if this ends early, it holds."""
    with wrong_option_named():
        job = job_of(
            target_of(target, pixel, box, point), place_of(place), job_id=job_id, deadline_s=deadline_s,
            max_force_n=max_force, from_above=from_above, clear_way=clear_way, queue=queue,
        )  # fmt: skip
    with attended(), connected("pick", config, overrides) as cell:
        reply = cell.command("pick", object_name=object_name, job=job)
        if not as_json:
            out.line(_begins(reply))
        shown, waiting = _Shown(as_json, cell), QueuedJob(cell, reply, err.line)
        result = _result_of(cell, reply, shown, waiting)
    shown.result(result)
    if result.result not in _FINE:
        raise typer.Exit(1)


def run(
    config: Config = DEFAULT_STATION,
    cycles: Annotated[int | None, typer.Option(min=1, max=MAX_CYCLES, help="Run this many picks.")] = None,
    until_empty: Annotated[
        bool,
        typer.Option("--until-empty", help="Pick until nothing is left or picks fail in a row."),
    ] = False,
    job_id: JobId = "",
    target: TargetText = None,
    pixel: Pixel = None,
    box: BoxPx = None,
    point: PointM = None,
    place: PlaceAt = None,
    deadline_s: DeadlineS = None,
    max_force: MaxForce = None,
    from_above: FromAbove = False,
    clear_way: ClearWay = False,
    queue: Queue = False,
    overrides: Set = None,
    as_json: Json = False,
) -> None:
    """Let the running cell pick several times, and wait. It must be Idle; if this ends early, it holds."""
    if (cycles is None) is not until_empty:
        raise typer.BadParameter("one of --cycles and --until-empty says how many picks.")
    with wrong_option_named():
        job = job_of(
            target_of(target, pixel, box, point), place_of(place), job_id=job_id, deadline_s=deadline_s,
            max_force_n=max_force, from_above=from_above, clear_way=clear_way, queue=queue,
        )  # fmt: skip
    station = load_station(config, overrides or [])
    wanted = CommandRequest(cycles=cycles or 1, until_empty=until_empty)
    batch = Batch(wanted, station.retry)
    with attended(), client.connect(station, client_id=client.client_name("run")) as cell:
        shown = _Shown(as_json, cell)
        reply = cell.command("start", cycles=wanted.cycles, until_empty=until_empty, job=job)
        if not as_json:
            out.line(_begins(reply))
        _follow(cell, batch, shown, QueuedJob(cell, reply, err.line), reply.job_id)
    if until_empty:
        shown.summary(batch)
    if not (batch.is_empty if until_empty else batch.picked == cycles):
        raise typer.Exit(1)


def _begins(reply: CommandReply) -> str:
    """Return what an accepted command begins, for a person."""
    if reply.position:
        return f"job {reply.job_id} waits at place {reply.position} of the queue; Ctrl-C drops it, and holds what moves"
    return f"cycle {reply.cycle_id} begins; Ctrl-C holds it"


def _follow(cell: Client, batch: Batch, shown: _Shown, waiting: QueuedJob, job_id: str) -> None:
    """Show messages until no further pick of a job follows, including when the cell stops or aborts."""
    while not batch.is_over:
        said = cell.next_said(_PATIENCE_S)
        if isinstance(said, CycleResult) and said.job.job_id == job_id:
            shown.result(said)
            batch.hear(said)
        elif isinstance(said, CellState):
            shown.state(said)
            waiting.hear(said)
            if said.state in ENDED:
                batch.end(shown.cause or said.state)


def _result_of(cell: Client, begun: CommandReply, shown: _Shown, waiting: QueuedJob) -> CycleResult:
    """The result of the pick that began so, of its last attempt. Raises: Refused (JOB_DROPPED), BusError."""
    following = Following(cell, begun.cycle_id, begun.job_id)
    for said in following:
        if isinstance(said, CellState):
            shown.state(said)
            waiting.hear(said)
        elif isinstance(said, CycleResult) and said.retried_as == following.cycle_id:
            shown.again(said)
    assert following.result is not None, "the iteration ends with it"
    return following.result


class _Shown:
    """Shows stages and results, and the cause when the cell is brought to rest meanwhile.

    Attributes:
        cause: the last such cause, "" for none.
    """

    def __init__(self, as_json: bool, cell: Client) -> None:
        self._as_json, self._cell = as_json, cell
        self._state = self._stage = ""
        self.cause = ""

    def state(self, state: CellState) -> None:
        """Process a state: a stage that begins is shown, and what holds, stops or aborts the pick."""
        is_new, self._state = state.state != self._state, state.state
        if state.stage not in ("", self._stage) and not self._as_json:
            out.line(f"  {state.stage}", style="dim")
            if state.stage == "approve":
                self._show_proposal()
        self._stage = state.stage
        if is_new and state.reason and state.state in ("Holding", "Suspending", "Stopping", "Aborting"):
            self.cause = told(state.state, state.reason)
            if not self._as_json:
                out.line(f"  {self.cause}")

    def _show_proposal(self) -> None:
        """Show what waits for an answer; nothing when it was answered meanwhile."""
        with suppress(Refused):
            out.line(f"  {self._cell.proposal().waits_in_words(time.time_ns())}: {_ANSWERED_BY}")

    def result(self, result: CycleResult) -> None:
        """Show a cycle's result, and its recording."""
        if self._as_json:
            out.json(result.model_dump_json())
            return
        out.line(f"{title_of(result.result, result.code or '', result.object)}: {result.reason}")
        if result.advice:
            out.line(f"  {result.advice}")
        if result.found is not None:
            out.line(f"  {result.found.text}")
        out.line(f"  {result.recording}")
        if result.retried_as:
            out.line(f"tried again as {result.retried_as}")

    def again(self, result: CycleResult) -> None:
        """Show an attempt that another follows; with JSON the last one alone is the answer."""
        if not self._as_json:
            self.result(result)

    def summary(self, batch: Batch) -> None:
        """Show the end of a batch; the objects left on the table are known only to the cell's own terminal."""
        summary = batch.summary(None)
        out.json(summary.model_dump_json()) if self._as_json else out.line(summary.line())


@contextmanager
def attended() -> Iterator[None]:
    """Context of a client that attends motion: Ctrl-C ends the client, and the message says what it leaves behind.

    Raises: typer.Exit(130) after Ctrl-C.
    """
    try:
        yield
    except KeyboardInterrupt:
        err.line("Interrupted: nobody attends the motion any more, so the cell holds it, or stops where it cannot.")
        err.line("To go on: `cell unhold`. To give it up: `cell stop`. What it does now: `cell status`.")
        raise typer.Exit(_INTERRUPTED) from None


@contextmanager
def connected(verb: str, config: Path, overrides: list[str] | None) -> Iterator[Client]:
    """A client named after its command."""
    station = load_station(config, overrides or [])
    with client.connect(station, client_id=client.client_name(verb)) as cell:
        yield cell
