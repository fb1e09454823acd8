"""The command line, ``cell --help``. Exits: 0 done, 1 robot failed, 2 usage or config, 3 refused, 4 unreachable."""

from __future__ import annotations

import json
import logging
import os
import signal
import sys
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from bus.commands import CommandRequest
from bus.errors import CellError, RecordingError
from bus.faults import PARTS, Fault
from bus.messages import CycleResult
from cell import calibrate, client, fleet, keys, nodes, recordings, replays
from cell import watch as watching
from cell.batch import Batch
from cell.build import running_cell
from cell.console import Screen
from cell.daemon import Daemon
from cell.doctor import examine
from cell.machine import refuse
from cell.service import Service, takes_commands
from config.load import DEFAULT_STATION, load_station
from config.schema import RetrySettings
from logs import live
from logs.recover import recover as recover_file

app = typer.Typer(
    help="VLAD Cell: picks objects it has never seen, explains every pick, and can replay it.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    epilog="Exit codes: 0 done, 1 the robot failed (code printed), 2 usage or configuration, 3 refused, 4 unreachable.",
)
app.add_typer(calibrate.app, name="calibrate")
_out = Console(highlight=False, soft_wrap=True)
_SETTLED = {"Stopped", "Idle", "Complete", "Aborted"}
_ENDED = {"Stopped", "Aborted"}
_RUNS_AGAIN = {"Execute", "Completing", "Complete", "Idle"}  # the last two when little of the cycle was left
_PATIENCE_S = 600.0
_TERMINAL = "terminal"
"""``client_id`` of what `cell start` itself commands; it needs no lease: with it the daemon ends."""

Config = Annotated[Path, typer.Option("--config", "-c", help="Station file.", show_default="the simulated cell")]
Set = Annotated[list[str] | None, typer.Option("--set", help="Override one setting: key=value. Repeatable.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON for programs.")]


def _print_json(value: Any) -> None:
    _out.out(json.dumps(value) if not isinstance(value, str) else value, highlight=False)


def _finish(result: CycleResult) -> None:
    """End with 1 when the robot failed."""
    if result.result not in ("SUCCESS", "EMPTY"):
        raise typer.Exit(1)


@app.command()
def start(
    config: Config = DEFAULT_STATION,
    cycles: Annotated[int | None, typer.Option(min=1, help="Reset, run this many picks, and end.")] = None,
    until_empty: Annotated[
        bool,
        typer.Option("--until-empty", help="Reset, pick until nothing is left or 3 picks in a row failed, and end."),
    ] = False,
    seed: Annotated[int | None, typer.Option(help="Seed of the simulated cell (= --set sim.seed).")] = None,
    objects: Annotated[
        Path | None, typer.Option(help="Folder of NAME/object.xml objects (= --set sim.objects).")
    ] = None,
    overrides: Set = None,
    as_json: Json = False,
    report: Annotated[bool, typer.Option(help="Write a report page for every cycle.")] = True,
    foxglove: Annotated[
        bool, typer.Option("--foxglove", help="Show the bus live to Foxglove or Lichtblick, on this machine only.")
    ] = False,
    foxglove_port: Annotated[int, typer.Option(min=1, max=65535, help="Where --foxglove listens.")] = live.DEFAULT_PORT,
) -> None:
    """Start the cell: the daemon and its nodes. Without --cycles or --until-empty it stays, and waits for commands."""
    if cycles is not None and until_empty:
        raise typer.BadParameter("--cycles and --until-empty exclude each other: a number of picks, or all of them.")
    extra = [f"sim.seed={seed}"] if seed is not None else []
    extra += [f"sim.objects={objects}"] if objects is not None else []
    station = load_station(config, [*(overrides or []), *extra])
    if foxglove:
        live.sdk()  # missing? then before anything starts
    service = Service(os.environ)
    screen = Screen(json_lines=as_json, report=report and not as_json, each_turn=service.turn)
    _on_signal(screen.interrupted.set)
    screen.line(f"cell [bold]{station.cell_id}[/] on {station.bus.endpoint}: starting {', '.join(station.nodes)} ...")
    with (
        running_cell(station, screen.observe) as daemon,
        live.watching(station.cell_id, station.bus.endpoint, foxglove_port) if foxglove else nullcontext() as view,
        service.around(lambda: takes_commands(daemon.machine)),
    ):
        if view is not None:
            screen.line(f"live view: open ws://{live.HOST}:{view.port} in Foxglove or Lichtblick (docs/foxglove)")
        if cycles is None and not until_empty:
            screen.line("ready. From another terminal: cell reset, cell pick, cell status. Ctrl-C ends.")
            for _ in screen.follow():
                pass
            return
        operator = CommandRequest(client_id=_TERMINAL, cycles=cycles or 1, until_empty=until_empty)
        batch = _run_batch(daemon, screen, operator, station.retry)
        if until_empty:
            screen.summary(batch.summary(daemon.objects_left()))
    done = batch.is_empty if until_empty else batch.picked == cycles
    if as_json and cycles is not None and batch.done < cycles:
        typer.echo(batch.reason, err=True)  # a cell that aborts between cycles gives no result that says why
    if screen.interrupted.is_set() or not done:
        raise typer.Exit(1)


def _run_batch(daemon: Daemon, screen: Screen, operator: CommandRequest, retry: RetrySettings) -> Batch:
    """Reset, then all picks of one ``start``; over also when the cell aborts, is stopped, or Ctrl-C was pressed."""
    batch = Batch(operator, retry)
    begun = False
    refuse(daemon.command("reset", operator))
    for said in screen.follow():
        if isinstance(said, CycleResult):
            batch.hear(said)
        elif said.state == "Idle" and not begun:
            begun = True
            refuse(daemon.command("start", operator))
        elif said.state in ("Aborted", "Stopped") and said.reason:
            batch.end(said.reason)
        if batch.is_over:
            break
    batch.end("Interrupted.")
    return batch


def _on_signal(end: Callable[[], None]) -> None:
    """First SIGINT or SIGTERM: a controlled end; the next one: at once."""

    def handle(number: int, _frame: object) -> None:
        end()
        signal.signal(number, signal.SIG_DFL)

    signal.signal(signal.SIGINT, handle)
    signal.signal(signal.SIGTERM, handle)


@app.command()
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
            _out.print(f"cycle {reply.cycle_id} begins; Ctrl-C holds it")
        result = cell.wait_for_result(reply.cycle_id, _PATIENCE_S)
    if as_json:
        _print_json(result.model_dump_json())
    else:
        _out.print(f"{result.result} {result.code or ''} {result.object}: {result.reason}\n  {result.recording}")
    _finish(result)


def _simple_command(verb: str, help_text: str, until: set[str] = _SETTLED) -> None:
    """Register ``cell VERB``: send it, wait until it is in a state of ``until``, or ended; print the state."""

    def run(config: Config = DEFAULT_STATION, overrides: Set = None, as_json: Json = False) -> None:
        with client.connect(load_station(config, overrides or [])) as cell:
            reply, wanted = cell.command(verb), until
            state = cell.wait_for_state(until | _ENDED, 60.0)
            if until is _RUNS_AGAIN and reply.lease == cell.client_id and state.state not in _ENDED:
                typer.echo("its client is gone: attended from here until it is over; Ctrl-C holds it", err=True)
                state, wanted = cell.wait_for_state(_SETTLED, _PATIENCE_S), _SETTLED - _ENDED
        _print_json(state.model_dump_json()) if as_json else _out.print(f"{state.state} {state.reason}".strip())
        if state.state not in wanted or (state.state == "Aborted" and verb != "abort"):
            raise typer.Exit(1)

    app.command(verb, help=help_text)(run)


_simple_command("reset", "Self-check, arm to the capture pose; ends in Idle.")
_simple_command("stop", "Controlled stop: brake on the path, confirm by the measured velocity; ends in Stopped.")
_simple_command("abort", "Brake now; ends in Aborted. Then: clear, reset, start - three deliberate acts.")
_simple_command("clear", "Clear an abort; ends in Stopped.")
_simple_command("hold", "Pause a running cycle: brake on the path and wait there; ends in Held.", {"Held"})
_simple_command("unhold", "Go on with a held cycle; returns when it runs again.", _RUNS_AGAIN)
_simple_command(
    "suspend", "Pause for a reason outside the cell; brakes as hold does; ends in Suspended.", {"Suspended"}
)
_simple_command("unsuspend", "Go on with a suspended cycle; returns when it runs again.", _RUNS_AGAIN)


@app.command()
def status(config: Config = DEFAULT_STATION, overrides: Set = None, as_json: Json = False) -> None:
    """The machine's state, what it would accept, and how its nodes are."""
    with client.connect(load_station(config, overrides or [])) as cell:
        state, health = cell.state(), cell.health()
    if as_json:
        _print_json({**state.model_dump(mode="json"), "health": health.model_dump(mode="json")})
        return
    _out.print(f"[bold]{state.state}[/] {state.stage} {state.cycle_id} {state.reason}".rstrip())
    _out.print(f"  available: {', '.join(state.available) or '-'}")
    for name, node in health.nodes.items():
        said = "; ".join(node.problems) or "healthy"
        again = f" (started again {node.restarts} times)" if node.restarts else ""
        _out.print(f"  node {name}: {said}{again}", style="red" if node.problems else "")


@app.command()
def watch(
    config: Config = DEFAULT_STATION,
    overrides: Set = None,
    once: Annotated[bool, typer.Option("--once", help="Print the view once and end.")] = False,
) -> None:
    """The running cell on one screen: state, last cycles, nodes; its commands are one key each. q ends the view."""
    watching.watch(load_station(config, overrides or []), once=once)


@app.command("fleet")
def fleet_(
    config: Config = DEFAULT_STATION,
    endpoint: Annotated[
        str | None, typer.Option(help="Where to look: a router's or a cell's endpoint (= --set bus.endpoint).")
    ] = None,
    overrides: Set = None,
    as_json: Json = False,
) -> None:
    """Every cell that can be seen from here: state, stage, since when, why, and what is wrong with it."""
    extra = [f"bus.endpoint={endpoint}"] if endpoint is not None else []
    members = fleet.fleet(load_station(config, [*(overrides or []), *extra]))
    if as_json:
        _print_json([member.to_json() for member in members])
        return
    for member in members:
        _out.print(member.line(time.time_ns()), style="red" if member.problems else "")
    if not members:
        _out.print("No cell can be seen from here.")


@app.command()
def router(
    config: Annotated[Path, typer.Option("--config", "-c", help="Zenoh file, e.g. the router.json5 of `cell keys`.")],
) -> None:
    """Run a Zenoh router, where cells and those who look after them meet; zenohd does the same with the same file."""
    fleet.route(config, _out.print)


@app.command("keys")
def keys_(
    folder: Annotated[Path, typer.Argument(help="Where to; outside of this project.")],
    hosts: Annotated[
        list[str] | None, typer.Option("--host", help="Address or name of the cell or the router. Repeatable.")
    ] = None,
) -> None:
    """Make TLS certificates and Zenoh files for every role: cell, router, node, operator, viewer (docs/security.md)."""
    written = keys.make_keys(folder, hosts or [])
    _out.print("\n".join(str(path) for path in written))
    _out.print("A machine of a role gets ca.pem and that role's .pem, .key and .json5. ca.key stays here.")


@app.command()
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
        _print_json(done.to_json()) if as_json else _out.print(done.line())
        lost = lost or done.lost
    if failed is not None or lost:
        raise typer.Exit(failed.exit_code if failed is not None else 1)


app.command()(replays.replay)
app.command()(recordings.report)
app.command()(recordings.show)
app.command()(recordings.cycles)


@app.command("config")
def show_config(config: Config = DEFAULT_STATION, overrides: Set = None) -> None:
    """Print the whole configuration, defaults included, as JSON."""
    _print_json(load_station(config, overrides or []).model_dump_json(indent=2))


@app.command()
def doctor(config: Config = DEFAULT_STATION, overrides: Set = None, as_json: Json = False) -> None:
    """Check this machine and the station's devices before the first start. Exit 0 nothing to fix, 1 something is."""
    if not examine.report(load_station(config, overrides or []), _out, as_json=as_json):
        raise typer.Exit(1)


@app.command()
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
    _out.print(f"{part}: {word}")


@app.command()
def node(
    name: Annotated[str, typer.Argument(help="Node of the station file.")],
    config: Config = DEFAULT_STATION,
    overrides: Set = None,
) -> None:
    """Serve one driver node on the bus (for nodes with run = "elsewhere"; the daemon runs the others)."""
    nodes.serve_until_interrupted(name, load_station(config, overrides or []))


def main() -> None:
    """Entry point: every known error becomes one clear line and its exit code, never a traceback."""
    logging.basicConfig(level=logging.WARNING, format=nodes.LOG_FORMAT)
    try:
        app()
    except CellError as error:
        if "--json" in sys.argv:
            _print_json(
                {
                    "ok": False,
                    "code": error.code,
                    "reason": error.text,
                    "advice": error.advice,
                    "available": list(getattr(error, "available", ())),
                }
            )
        typer.echo(f"{error.code}: {error}", err=True)
        sys.exit(error.exit_code)


if __name__ == "__main__":
    main()
