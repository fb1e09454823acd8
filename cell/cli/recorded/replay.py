"""``cell replay``: rerun a recorded cycle, or a folder of them, and compare; or publish it again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bus.session import Bus
from cell.cli.options import Config, Count, Json, Scheduler, Set, finite
from cell.cli.recorded.folders import InFolder, find_cycle, is_all_of
from cell.replay import view
from cell.replay.folder import Tally, judgements, recordings_below
from cell.replay.replay import Request
from cell.replay.replay import replay as run_again
from cell.replay.republish import ROOT, await_listener, payloads, republish, require_no_live_cell
from cell.replay.what_if import what_if
from cell.terminal.drawing import tracked
from cell.terminal.printing import err, out
from cell.terminal.signals import ending
from cell.workers import workers_for
from config.load import DEFAULT_STATION, station_from
from logs.mcap.names import shown, telling
from logs.mcap.reader import read_cycle
from logs.report.cycle_report import write_report


def replay(
    cycle: Annotated[
        str, typer.Argument(metavar="FILE|CYCLE|FOLDER", help="A recording (.mcap), a cycle's id, or a folder of them.")
    ],
    start: Annotated[
        str | None, typer.Option("--from", metavar="STAGE", help="Chained: from this stage on, outputs flow on.")
    ] = None,
    only: Annotated[
        str | None, typer.Option(metavar="STAGE", help="This stage alone, from its recorded inputs.")
    ] = None,
    live_models: Annotated[
        bool, typer.Option("--live-models", help="Ask the models again, instead of their recorded replies.")
    ] = False,
    publish: Annotated[
        bool,
        typer.Option("--publish", help="Instead: put it on the bus again, below replay/CYCLE_ID/, for a subscriber."),
    ] = False,
    rate: Annotated[
        float, typer.Option(min=0.01, help="With --publish: so many times as fast as it was.", callback=finite)
    ] = 1.0,
    endpoint: Annotated[
        str, typer.Option(help="With --publish: where to listen for subscribers.")
    ] = "tcp/127.0.0.1:7448",
    wait_s: Annotated[
        float,
        typer.Option(
            min=0,
            help="With --publish: wait so long for the first subscriber [s]; 0 = publish at once, whoever listens.",
            callback=finite,
        ),
    ] = 30.0,
    workers: Count = None,
    scheduler: Scheduler = "",
    folder: InFolder = None,
    config: Config = DEFAULT_STATION,
    overrides: Set = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write the page of a cycle that would have been so.")
    ] = None,
    details: Annotated[
        bool, typer.Option("--details", help='Of a "what if?": also each value that differs, stage by stage.')
    ] = False,
    as_json: Json = False,
) -> None:
    """Run the pure stages again from recordings and compare. Exit 0 equal, 1 different, 2 cannot.

    Every stage works on its recorded inputs; with --from, or with --set ("what if?"), what one gives is what the next
    one takes, down to the chosen grasp. Stages: detect, plan, verify. What only acts while
    the arm moves (as most of execute) changes nothing here.

    --publish waits for a subscriber, as nothing is kept for a later one. Exit 0 published, 3 the recorded cell is live,
    4 nobody subscribed: nothing was published.
    """
    if start is not None and only is not None:
        raise typer.BadParameter("--from and --only exclude each other: a chain of stages, or one alone.")
    if publish:
        _publish(find_cycle(cycle, config, folder), rate, endpoint, wait_s)
        return
    request = Request.of(overrides or [], start, only, live_models=live_models)
    is_folder = is_all_of(cycle, folder)
    if output is not None and (not request.chained or is_folder):
        raise typer.BadParameter("--output is of one recording, with --set or --from: what would have been?")
    if is_folder:
        _replay_folder(Path(cycle), request, workers, scheduler, as_json=as_json)
        return
    path = find_cycle(cycle, config, folder)
    with telling(shown(path)):
        outcome = run_again(read_cycle(path), request)
    out.json(view.to_json(outcome)) if as_json else view.show(outcome, out, details=details)
    if output is not None:
        (err if as_json else out).line(f"  page {write_report(what_if(outcome, request.overrides), output)}")
    said = view.verdict(outcome)
    if said != "equal":
        raise typer.Exit(1 if said == "different" else 2)


def _publish(file: Path, rate: float, endpoint: str, wait_s: float) -> None:
    record = read_cycle(file)
    station = station_from(dict(record.station), [f"bus.endpoint={endpoint}"], source="the recorded station")
    require_no_live_cell(station_from(dict(record.station), source="the recorded station"))
    said = list(payloads(file))
    with ending(_interrupt), Bus.listen(station.cell_id, station.bus.endpoint) as bus:
        waits = f"waiting up to {wait_s:g} s for a subscriber; " if wait_s else ""
        err.line(f"{len(said)} payloads on {ROOT}/{record.cycle_id}/** at {endpoint}: {waits}Ctrl-C ends")
        await_listener(bus, record.cycle_id, wait_s)
        again = republish(bus, record.cycle_id, said, rate)
        for _ in tracked(again, len(said), record.cycle_id, err):
            pass
    err.line(f"{len(said)} payloads published")


def _interrupt() -> None:
    """Handle every request to end as Ctrl-C. Raises: KeyboardInterrupt."""
    raise KeyboardInterrupt


def _replay_folder(folder: Path, request: Request, count: int | None, scheduler: str, *, as_json: bool) -> None:
    paths, tally = recordings_below(folder), Tally()
    outcomes = judgements(paths, request, workers_for(len(paths), count, scheduler))
    for judged in tracked(outcomes, len(paths), f"replaying {len(paths)} recordings", err):
        tally.add(judged)
        err.line(f"{judged.path.stem} {judged.in_words}")
    if as_json:
        out.json(tally.to_json())
    else:
        view.show_tally(tally.to_json(), out)
    raise typer.Exit(tally.exit_code)
