"""``cell pick``, ``reset``, ``stop`` and so on, ``status``, ``fault``: what is asked of a cell that runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import typer

from bus.faults import PARTS, Fault
from cell import client
from cell.options import Config, Json, Set, out, print_json
from config.load import DEFAULT_STATION, load_station

_SETTLED = {"Stopped", "Idle", "Complete", "Aborted"}
_ENDED = {"Stopped", "Aborted"}
_RUNS_AGAIN = {"Execute", "Completing", "Complete", "Idle"}  # the last two when little of the cycle was left
_PATIENCE_S = 600.0


def pick(
    config: Config = DEFAULT_STATION,
    object_name: Annotated[str | None, typer.Option("--object", help="Simulation: the object to present.")] = None,
    overrides: Set = None,
    as_json: Json = False,
) -> None:
    """Pick one object, and wait for the result. The cell must be Idle or Complete; if this ends early, it holds."""
    with client.connect(load_station(config, overrides or [])) as cell:
        reply = cell.command("pick", object_name=object_name)
        if not as_json:
            out.print(f"cycle {reply.cycle_id} begins; Ctrl-C holds it")
        result = cell.wait_for_result(reply.cycle_id, _PATIENCE_S)
    if as_json:
        print_json(result.model_dump_json())
    else:
        outcome = " ".join(filter(None, (result.result, result.code, result.object)))
        out.print(f"{outcome}: {result.reason}\n  {result.recording}")
    if result.result not in ("SUCCESS", "EMPTY"):
        raise typer.Exit(1)


def _simple(verb: str, help_text: str, until: set[str] = _SETTLED) -> Callable[..., None]:
    """The command without arguments ``verb``: send it, wait for a state of ``until``, or an end; print the state."""

    def run(config: Config = DEFAULT_STATION, overrides: Set = None, as_json: Json = False) -> None:
        with client.connect(load_station(config, overrides or [])) as cell:
            reply, wanted = cell.command(verb), until
            state = cell.wait_for_state(until | _ENDED, 60.0)
            if until is _RUNS_AGAIN and reply.lease == cell.client_id and state.state not in _ENDED:
                typer.echo("its client is gone: attended from here until it is over; Ctrl-C holds it", err=True)
                state, wanted = cell.wait_for_state(_SETTLED, _PATIENCE_S), _SETTLED - _ENDED
        print_json(state.model_dump_json()) if as_json else out.print(f"{state.state} {state.reason}".strip())
        if state.state not in wanted or (state.state == "Aborted" and verb != "abort"):
            raise typer.Exit(1)

    run.__doc__ = help_text
    return run


reset = _simple("reset", "Self-check, arm to the capture pose; ends in Idle.")
stop = _simple("stop", "Controlled stop: brake on the path, confirm by the measured velocity; ends in Stopped.")
abort = _simple("abort", "Brake now; ends in Aborted. Then: clear, reset, start - three deliberate acts.")
clear = _simple("clear", "Clear an abort; ends in Stopped.")
hold = _simple("hold", "Pause a running cycle: brake on the path and wait there; ends in Held.", {"Held"})
unhold = _simple("unhold", "Go on with a held cycle; returns when it runs again.", _RUNS_AGAIN)
suspend = _simple(
    "suspend", "Pause for a reason outside the cell; brakes as hold does; ends in Suspended.", {"Suspended"}
)
unsuspend = _simple("unsuspend", "Go on with a suspended cycle; returns when it runs again.", _RUNS_AGAIN)


def status(config: Config = DEFAULT_STATION, overrides: Set = None, as_json: Json = False) -> None:
    """The machine's state, what it would accept, and how its nodes are."""
    with client.connect(load_station(config, overrides or [])) as cell:
        state, health = cell.state(), cell.health()
    if as_json:
        print_json({**state.model_dump(mode="json"), "health": health.model_dump(mode="json")})
        return
    out.print(f"[bold]{state.state}[/] {state.stage} {state.cycle_id} {state.reason}".rstrip())
    out.print(f"  available: {', '.join(state.available) or '-'}")
    for name, node in health.nodes.items():
        said = "; ".join(node.problems) or "healthy"
        again = f" (started again {node.restarts} times)" if node.restarts else ""
        out.print(f"  node {name}: {said}{again}", style="red" if node.problems else "")


def fault(
    part: Annotated[str, typer.Argument(help=f"One of: {', '.join(PARTS)}.", show_default=False)],
    word: Annotated[Fault, typer.Argument(help="How it is to misbehave; none ends it.", show_default=False)],
    config: Config = DEFAULT_STATION,
    overrides: Set = None,
    delay_s: Annotated[float | None, typer.Option("--delay-s", help="How late a slow one answers.")] = None,
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
    out.print(f"{part}: {word}")
