"""``cell start``: the daemon and its nodes in this process, until its picks are done or it is asked to end."""

from __future__ import annotations

import os
import shlex
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Annotated

import typer

from bus.commands import MAX_CYCLES, CellState, CommandRequest
from bus.errors import PortOccupied
from bus.messages import CycleResult
from cell.build import running_cell
from cell.cli.options import Config, Json, Set
from cell.cli.serving.console import Screen
from cell.cli.serving.doors import open_doors, wanted_doors
from cell.daemon.batch import Batch
from cell.daemon.daemon import Daemon
from cell.daemon.systemd import Service, takes_commands
from cell.doctor.finding import Verdict
from cell.doctor.judging import double_picks
from cell.doctor.reach import running
from cell.machine.owner import refuse
from cell.terminal.printing import err
from cell.terminal.signals import on_end
from config.clock import clock_of
from config.load import DEFAULT_STATION, load_station
from config.pick import RetrySettings
from config.schema import Station
from config.undecided import undecided
from logs import live

_TERMINAL = "terminal"
"""``client_id`` of the commands of `cell start` itself; it needs no lease, because the daemon ends with it."""


def start(
    config: Config = DEFAULT_STATION,
    cycles: Annotated[
        int | None, typer.Option(min=1, max=MAX_CYCLES, help="Reset, run this many picks, and end.")
    ] = None,
    until_empty: Annotated[
        bool,
        typer.Option("--until-empty", help="Reset, pick until nothing is left or picks fail in a row, and end."),
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
    opcua: Annotated[
        bool, typer.Option("--opcua", help="Serve the cell over OPC UA, too (= --set opcua.enabled=true).")
    ] = False,
    http: Annotated[
        bool, typer.Option("--http", help="Serve the cell over HTTP, too (= --set http.enabled=true).")
    ] = False,
) -> None:
    """Start the cell: the daemon and its nodes. Without --cycles or --until-empty it stays, and waits for commands."""
    if cycles is not None and until_empty:
        raise typer.BadParameter("--cycles and --until-empty exclude each other: a number of picks, or all of them.")
    extra = [f"sim.seed={seed}"] if seed is not None else []
    extra += [f"sim.objects={objects}"] if objects is not None else []
    options = {"sim.seed": "--seed", "sim.objects": "--objects"} if extra else {}
    station = load_station(config, [*(overrides or []), *extra], given_by=options)
    named = {"opcua": opcua, "http": http}
    doors = wanted_doors(station, *(name for name, is_named in named.items() if is_named))
    if foxglove:
        live.sdk()  # fails before anything starts if it is missing
    wanted = CommandRequest(client_id=_TERMINAL, cycles=cycles or 1, until_empty=until_empty)
    picks = wanted if cycles is not None or until_empty else None
    service = Service(os.environ)
    screen = Screen(json_lines=as_json, report=report and not as_json, each_turn=service.turn)
    if not station.simulated and (left := undecided(config)) is not None:
        screen.line(f"{left[0]}. {left[1]}")
    on_end(screen.interrupted.set, insists=True)
    try:
        ready = _ready(config, overrides or [])
        batch = _run(station, picks, screen, service, foxglove_port if foxglove else None, doors, ready)
    except PortOccupied as error:
        raise _occupied(station, error) from error
    if batch is None:
        return
    if as_json and cycles is not None and batch.done < cycles:
        err.line(batch.reason)  # a cell that aborts between cycles publishes no result with the reason
    if screen.interrupted.is_set() or not (batch.is_empty if until_empty else batch.picked == cycles):
        raise typer.Exit(1)


def _run(
    station: Station,
    picks: CommandRequest | None,
    screen: Screen,
    service: Service,
    view_port: int | None,
    doors: list[str],
    ready: str,
) -> Batch | None:
    """Run the cell for these ``picks``; without any, say ``ready``, and take commands until interrupted."""
    screen.line(f"cell {station.cell_id} on {station.bus.endpoint}: starting {', '.join(station.nodes)} ...")
    if not station.simulated and (asks := double_picks(station)).verdict is not Verdict.OK:
        screen.line(asks.found)
    with (
        screen.to_the_end(),
        running_cell(station, screen.observe) as daemon,
        _live_view(station, view_port) as view,
        service.around(lambda: takes_commands(daemon.machine)),
        open_doors(station, doors, daemon.publisher.publish_event, daemon.hear_door),
    ):
        if view is not None:
            screen.line(f"live view: open ws://{live.HOST}:{view.port} in Foxglove or Lichtblick (docs/foxglove)")
        if picks is None:
            _stay(screen, ready)
            return None
        batch = _run_batch(daemon, screen, picks, station.retry)
        if picks.until_empty:
            screen.summary(batch.summary(daemon.objects_left()))
        return batch


def _occupied(station: Station, error: PortOccupied) -> PortOccupied:
    """The error with the program that uses the port: this very cell, or another program."""
    if running(station) is None:
        return error
    return PortOccupied(
        f"A cell already runs here: {station.cell_id} at {station.bus.endpoint}.",
        "To let it pick: `cell pick`, or `cell run --cycles N`; what it does now: `cell status`.",
    )


def _live_view(station: Station, port: int | None) -> AbstractContextManager[live.LiveView | None]:
    """Context with the live view for Foxglove; empty without a ``port``."""
    if port is None:
        return nullcontext()
    return live.watching(station.cell_id, station.bus.endpoint, port, clock_of(station))


def _ready(config: Path, overrides: list[str]) -> str:
    """Return a line that says how to command this very cell, in the words that it was started with."""
    cell = "uv run cell" if "UV_RUN_RECURSION_DEPTH" in os.environ else "cell"
    words = ["--config", str(config)] if config != DEFAULT_STATION else []
    for override in overrides:
        if override.partition(".")[0] == "bus" or override.partition("=")[0].strip() == "cell_id":
            words += ["--set", override]
    each = f", each with {shlex.join(words)}" if words else ""
    return f"ready. From another terminal{each}: {cell} reset, {cell} pick, {cell} status. Ctrl-C ends."


def _stay(screen: Screen, ready: str) -> None:
    """Show all messages until interrupted."""
    if screen.interrupted.is_set():
        return  # during the start: it was never ready for anybody
    screen.line(ready)
    for _ in screen.follow():
        pass


def _run_batch(daemon: Daemon, screen: Screen, operator: CommandRequest, retry: RetrySettings) -> Batch:
    """Reset, then run all picks of one ``start``; also over when the cell aborts, is stopped, or Ctrl-C is pressed."""
    batch = Batch(operator, retry)
    begun = has_moved = False
    refuse(daemon.command("reset", operator))
    for said in screen.follow():
        if isinstance(said, CycleResult):
            batch.hear(said)
        elif said.state == "Idle" and not begun:
            begun = True
            refuse(daemon.command("start", operator))
        elif said.state == "Aborted" or (said.state == "Stopped" and has_moved):
            batch.end(said.reason or "The cell was stopped.")
        has_moved = has_moved or (isinstance(said, CellState) and said.state != "Stopped")
        if batch.is_over:
            break
    batch.end("Interrupted.")
    return batch
