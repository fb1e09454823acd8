"""The command line, ``cell --help``. Exits: 0 done, 1 robot failed, 2 usage or config, 3 refused, 4 unreachable."""

from __future__ import annotations

import json
import logging
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from bus.commands import CommandRequest
from bus.errors import CellError, RecordingError
from bus.messages import CycleResult
from cell import calibrate, client, nodes
from cell import watch as watching
from cell.batch import Batch
from cell.build import running_cell
from cell.console import Screen
from cell.daemon import Daemon
from cell.doctor import examine
from cell.machine import refuse
from cell.replay import replay_file
from cell.service import Service, takes_commands
from config.load import DEFAULT_STATION, load_station
from config.schema import Station
from logs.index import list_cycles
from logs.reader import read_cycle
from logs.recover import recover as recover_file
from logs.report import write_report

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
File = Annotated[Path, typer.Argument(help="A cycle's recording (.mcap).")]


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
) -> None:
    """Start the cell: the daemon and its nodes. Without --cycles or --until-empty it stays, and waits for commands."""
    if cycles is not None and until_empty:
        raise typer.BadParameter("--cycles and --until-empty exclude each other: a number of picks, or all of them.")
    extra = [f"sim.seed={seed}"] if seed is not None else []
    extra += [f"sim.objects={objects}"] if objects is not None else []
    station = load_station(config, [*(overrides or []), *extra])
    service = Service(os.environ)
    screen = Screen(json_lines=as_json, report=report and not as_json, each_turn=service.turn)
    _on_signal(screen.interrupted.set)
    screen.line(f"cell [bold]{station.cell_id}[/] on {station.bus.endpoint}: starting {', '.join(station.nodes)} ...")
    with running_cell(station, screen.observe) as daemon, service.around(lambda: takes_commands(daemon.machine)):
        if cycles is None and not until_empty:
            screen.line("ready. From another terminal: cell reset, cell pick, cell status. Ctrl-C ends.")
            for _ in screen.follow():
                pass
            return
        operator = CommandRequest(client_id=_TERMINAL, cycles=cycles or 1, until_empty=until_empty)
        batch = _run_batch(daemon, screen, operator)
        if until_empty:
            screen.summary(batch.summary(daemon.objects_left()))
    done = batch.is_empty if until_empty else batch.picked == cycles
    if screen.interrupted.is_set() or not done:
        raise typer.Exit(1)


def _run_batch(daemon: Daemon, screen: Screen, operator: CommandRequest) -> Batch:
    """Reset, then all picks of one ``start``; over also when the cell aborts, is stopped, or Ctrl-C was pressed."""
    batch = Batch(operator)
    refuse(daemon.command("reset", operator))
    for said in screen.follow():
        if isinstance(said, CycleResult):
            batch.hear(said)
        elif said.state == "Idle" and batch.done == 0:
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


@app.command()
def replay(file: File, overrides: Set = None, as_json: Json = False) -> None:
    """Run the pure stages again from a recording and compare. Exit 0 equal, 1 different, 2 cannot."""
    outcome = replay_file(file, overrides or [])
    if as_json:
        _print_json(outcome.to_json())
    else:
        outcome.show(_out)
    if not outcome.equal:
        raise typer.Exit(1)


@app.command()
def report(
    file: File, output: Annotated[Path | None, typer.Option("--output", "-o", help="Where to write the page.")] = None
) -> None:
    """Write one self-contained HTML page that explains a cycle."""
    _out.print(str(write_report(read_cycle(file), output or file.with_suffix(".html"))))


@app.command()
def show(file: File, as_json: Json = False) -> None:
    """What a recording holds: result, stages, versions."""
    record = read_cycle(file)
    if as_json:
        _print_json({"result": record.result.model_dump(mode="json") if record.result else None,
                     "stages": {name: stage.duration_s for name, stage in record.stages.items()},
                     "metadata": record.metadata})  # fmt: skip
        return
    if record.result is not None:
        result = record.result
        _out.print(f"[bold]{result.result}[/] {result.code or ''} {result.object}: {result.reason}")
    else:
        _out.print(f"[bold]{record.metadata.get('result', 'UNFINISHED')}[/] {record.metadata.get('reason', '')}")
    for name, stage in record.stages.items():
        _out.print(f"  {name:<8} {stage.duration_s:6.2f} s  {stage.failure.text if stage.failure else ''}".rstrip())
    for key, value in record.metadata.items():
        _out.print(f"  [dim]{key:<24} {value}[/]")


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


@app.command()
def cycles(
    folder: Annotated[Path | None, typer.Argument(help="Recordings folder.")] = None,
    config: Config = DEFAULT_STATION,
    as_json: Json = False,
) -> None:
    """List recorded cycles, newest first."""
    for entry in list_cycles(folder or load_station(config).recording.folder):
        _print_json(entry.to_json()) if as_json else _out.print(entry.line())


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
def node(
    name: Annotated[str, typer.Argument(help="Node of the station file.")],
    config: Config = DEFAULT_STATION,
    overrides: Set = None,
    supervised: Annotated[bool, typer.Option("--supervised", hidden=True)] = False,
) -> None:
    """Serve one driver node on the bus (for nodes with run = "elsewhere"; the daemon runs the others)."""
    if supervised:
        raise typer.Exit(nodes.serve_supervised(name, sys.stdin, nodes.own_stdout()))
    station: Station = load_station(config, overrides or [])
    nodes.serve_until_interrupted(name, station)


def main() -> None:
    """Entry point: every known error becomes one clear line and its exit code, never a traceback."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
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
