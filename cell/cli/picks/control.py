"""Commands to a running cell: ``cell reset``, ``stop`` and so on, ``status``, ``fault``."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from collections.abc import Set as AbstractSet
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Annotated

import typer

from bus.commands import CellState, CommandRequest
from bus.errors import Refused
from bus.fault_injection import PARTS, Fault
from bus.messages import Job, Proposal
from cell import client
from cell.cli.options import Config, Json, Set, finite
from cell.cli.picks.pick import attended, connected
from cell.client import LEADS_TO, RUNS_AGAIN, Client
from cell.machine.leases import NEEDS_LEASE, NEEDS_TOKEN
from cell.machine.states import ENDED, READY, SETTLED, told
from cell.terminal.printing import err, out
from config.load import DEFAULT_STATION, load_station

_PATIENCE_S, _ATTENDED_S = 60.0, 600.0


def _simple(verb: str, help_text: str) -> Callable[..., None]:
    """A command without arguments: send ``verb``, wait for a state that it leads to, or an end; print the state."""

    def run(config: Config = DEFAULT_STATION, overrides: Set = None, as_json: Json = False) -> None:
        with attended() if verb in NEEDS_LEASE | NEEDS_TOKEN else nullcontext():
            state, wanted = _carry_out(verb, config, overrides)
        out.json(state.model_dump_json()) if as_json else out.line(_in_words(state))
        if state.state not in wanted or (state.state == "Aborted" and verb != "abort"):
            raise typer.Exit(1)

    run.__doc__ = help_text
    return run


def _carry_out(verb: str, config: Path, overrides: list[str] | None) -> tuple[CellState, AbstractSet[str]]:
    """The state that was reached, and the set of states that count as success."""
    until = LEADS_TO[verb]
    with connected(verb, config, overrides) as cell:
        reply = cell.command(verb)
        state = cell.wait_for_state({*until, *ENDED}, _PATIENCE_S)
        if until is not RUNS_AGAIN or reply.lease != cell.client_id or state.state in ENDED:
            return state, until
        err.line("its client is gone: attended from here until it is over; Ctrl-C holds it")
        return cell.wait_for_state(set(SETTLED), _ATTENDED_S), READY


def _in_words(state: CellState) -> str:
    why = told(state.state, state.reason)
    return why if why != state.reason else f"{state.state} {state.reason}".strip()


reset = _simple("reset", "Self-check, arm to the capture pose; ends in Idle.")
stop = _simple("stop", "Controlled stop: brake on the path, confirm by the measured velocity; ends in Stopped.")
abort = _simple("abort", "Brake now; ends in Aborted. Then: clear, reset, start - three deliberate acts.")
clear = _simple("clear", "Clear an abort; ends in Stopped.")
hold = _simple("hold", "Pause a running cycle: brake on the path and wait there; ends in Held.")
unhold = _simple("unhold", "Go on with a held cycle; returns when it runs again.")
suspend = _simple("suspend", "Pause for a reason outside the cell; brakes as hold does; ends in Suspended.")
unsuspend = _simple("unsuspend", "Go on with a suspended cycle; returns when it runs again.")


def cancel(
    job_id: Annotated[str, typer.Argument(metavar="JOB", help="Id of the job: `cell status` lists them.")],
    config: Config = DEFAULT_STATION,
    overrides: Set = None,
) -> None:
    """Cancel a job that waits, or whose grasp has not begun: nothing of it moves then."""
    with connected("cancel", config, overrides) as cell:
        cell.command("cancel", job=Job(job_id=job_id))
    out.line(f"job {job_id} is cancelled")


def approve(
    proposal: Annotated[
        str,
        typer.Argument(metavar="PROPOSAL", help="Its id, as `cell status` names it: approved without being asked."),
    ] = "",
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Approve what waits, whatever it is, unasked.")] = False,
    config: Config = DEFAULT_STATION,
    overrides: Set = None,
    as_json: Json = False,
) -> None:
    """Approve the planned pick that waits (execute.approve): the arm moves. Shows it, and asks first."""
    if not (proposal or yes or sys.stdin.isatty()):
        raise typer.BadParameter("nobody can be asked here: name the PROPOSAL, as `cell status` does, or say --yes.")
    with connected("approve", config, overrides) as cell:
        asked = cell.proposal()
        if not (proposal or yes) and not _agrees(asked):
            err.line("Not approved: nothing moves. `cell next-grasp`, or `cell reject` with the reason.")
            raise typer.Exit(1)
        cell.send("approve", CommandRequest(proposal=proposal or asked.proposal_id))
    _show_answered("approve", asked, as_json)


def _agrees(asked: Proposal) -> bool:
    """Show what waits, and ask the person at the terminal; what ends the question is a no."""
    err.line(f"It would take {asked.waits_in_words(time.time_ns())}.")
    try:
        return typer.confirm("Approve? The arm moves", default=False, err=True)
    except typer.Abort:
        err.line("")
        return False


def next_grasp(
    reason: Annotated[str, typer.Option("--reason", help="Why; it is recorded.")] = "",
    config: Config = DEFAULT_STATION,
    overrides: Set = None,
    as_json: Json = False,
) -> None:
    """Pass over the grasp that waits for approval: the next feasible one is planned, and waits."""
    _answer("next_grasp", reason, config, overrides, as_json)


def reject(
    reason: Annotated[str, typer.Argument(metavar="REASON", help="Why; it is recorded.")] = "",
    config: Config = DEFAULT_STATION,
    overrides: Set = None,
    as_json: Json = False,
) -> None:
    """Reject the planned pick that waits for approval: its cycle ends REJECTED, and is not tried again."""
    _answer("reject", reason, config, overrides, as_json)


def _answer(verb: str, reason: str, config: Path, overrides: list[str] | None, as_json: bool) -> None:
    with connected(verb, config, overrides) as cell:
        asked = cell.proposal()
        cell.send(verb, CommandRequest(proposal=asked.proposal_id, reason=reason))
    _show_answered(verb, asked, as_json)


def _show_answered(verb: str, asked: Proposal, as_json: bool) -> None:
    if as_json:
        out.json(asked.model_dump_json())
    else:
        out.line(f"{verb.replace('_', ' ')}: {asked.proposal_id}, {asked.in_words}")


def status(config: Config = DEFAULT_STATION, overrides: Set = None, as_json: Json = False) -> None:
    """Show the machine's state, what it would accept, and how its nodes and doors are."""
    with client.connect(load_station(config, overrides or [])) as cell:
        state, health = cell.state(), cell.health()
        asked = _waiting(cell, state)
    if as_json:
        proposal = asked.model_dump(mode="json") if asked is not None else None
        out.json({**state.model_dump(mode="json"), "health": health.model_dump(mode="json"), "proposal": proposal})
        return
    why = told(state.state, state.reason)
    said = why.removeprefix(state.state) if why != state.reason else f" {why}"
    out.line((state.state, "bold"), f" {state.stage} {state.cycle_id}".rstrip(), said.rstrip())
    out.line(f"  available: {', '.join(state.available) or '-'}")
    if asked is not None:
        out.line(f"  waits for approval: {asked.waits_in_words(time.time_ns())}", style="bold")
    if state.mode != "Production":
        out.line(f"  mode: {state.mode}", style="bold")
    if state.job_id or state.queue:
        out.line(f"  job: {state.job_id or '-'}, waiting: {', '.join(state.queue) or '-'}")
    if state.asked_by:
        out.line(f"  asked for by: {state.asked_by}")
    for name, node in health.nodes.items():
        said = "; ".join(node.problems) or "healthy"
        again = f" (restarts: {node.restarts})" if node.restarts else ""
        out.line(f"  node {name}: {said}{again}", style="red" if node.problems else "")
    for name, door in health.doors.items():
        said = f"{door.problem} {door.advice}".strip() or door.endpoint or "opens"
        out.line(f"  door {name}: {said}", style="red" if door.problem else "")
    for defect in health.defects:
        out.line(f"  defect: {defect}", style="red")


def _waiting(cell: Client, state: CellState) -> Proposal | None:
    """Return the proposal that waits for approval; None when nothing does, or it was answered meanwhile."""
    if state.stage != "approve":
        return None
    with suppress(Refused):
        return cell.proposal()
    return None


def fault(
    part: Annotated[str, typer.Argument(help=f"One of: {', '.join(PARTS)}.", show_default=False)],
    word: Annotated[Fault, typer.Argument(help="How it is to misbehave; none ends it.", show_default=False)],
    config: Config = DEFAULT_STATION,
    overrides: Set = None,
    delay_s: Annotated[
        float | None, typer.Option("--delay-s", min=0, help="How late a slow one answers.", callback=finite)
    ] = None,
) -> None:
    """Tell a part of a running cell to misbehave, to see what it does: docs/faults.md. Needs faults.allowed = true.

    Not for a robot among people: an arm that is wrong moves elsewhere than planned, into whatever stands there. Stops
    always reach it.
    """
    known = {str(one): one for one in PARTS}
    if part not in known:
        raise typer.BadParameter(f"{part!r} is none of {', '.join(PARTS)}.")
    with client.connect(load_station(config, overrides or [])) as cell:
        cell.fault(known[part], word, delay_s)
    out.line(f"{part}: {word}")
