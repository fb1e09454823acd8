"""``uv run python -m benchmarks NAME``: runs one benchmark, and prints its figures as one JSON object."""

from __future__ import annotations

import json
import os
import time
from collections import Counter
from collections.abc import Callable
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Annotated, Any

import typer

from benchmarks import (
    alignment,
    busy,
    calibration,
    catalogue,
    cluster,
    contact,
    cycle_time,
    detection,
    export,
    fleet,
    freezing,
    fusion,
    grasps,
    grouped,
    house,
    intruder,
    models,
    moves,
    planning,
    real_frames,
    recordings,
    segmenters,
    soak,
    stopping,
    torn,
    travel,
)
from benchmarks.drifted import REGIMES
from benchmarks.heaps import run as heaps
from benchmarks.heaps.plan import HEAPS, SETS
from benchmarks.held import run as held
from benchmarks.interfaces.multi_pick import multi_pick
from benchmarks.openness import trouble
from benchmarks.telling import say
from bus.commands import CommandRequest
from bus.errors import CellError
from bus.messages import CycleResult
from cell.build import running_cell
from cell.cli.serving.console import Screen
from cell.machine.owner import refuse
from cell.workers import ClusterWorkers, LocalWorkers, Workers
from config.load import load_station
from perception.detectors.registry import GROUP as DETECTORS

_ENDS_THE_RUN = ("EMPTY", "ABORTED")
_NEXT_COMMAND = {"Aborted": "clear", "Stopped": "reset", "Complete": "reset", "Idle": "start"}
"""The operator's next command after a run that ended early."""
_CHECKOUT = Path(__file__).resolve().parents[1]
_OBJECTS = Path(os.environ.get("VLAD_CELL_DATA", "../shared/data")) / "meshes" / "object_sim"
Scheduler = Annotated[str, typer.Option(help="Work on the Dask cluster of this scheduler, tcp://HOST:PORT.")]

# In mode "rich" a unit like [s] would be a style, and vanish.
app = typer.Typer(no_args_is_help=True, add_completion=False, help=__doc__, rich_markup_mode="markdown")


@app.command()
def cycle(
    cycles: Annotated[int, typer.Option(min=1)] = 20,
    seed: int = 1,
    overrides: Annotated[list[str] | None, typer.Option("--set", help="key=value")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """Simulated picks of the paper's objects: how they ended, the median time of every stage, and where it goes [s].

    robot_s: by the simulation's clock, with the least time of the same paths; wall_s: by that of the wall.
    from_end_to_end_s_median: by the wall, with what the cell does between two cycles.
    """
    station = load_station(None, [f"sim.seed={seed}", *(overrides or [])])
    screen = Screen(json_lines=as_json, report=False)
    results: list[CycleResult] = []
    ended_s: list[float] = []
    with running_cell(station, screen.observe) as daemon:
        for said in screen.follow(quiet=True):
            if isinstance(said, CycleResult):
                results.append(said)
                ended_s.append(time.monotonic())
                screen.line(f"{len(results)}/{cycles} {said.object} {said.result} {said.code or ''}")
                if len(results) == cycles:
                    break
                continue
            ended = not results or results[-1].result in _ENDS_THE_RUN
            verb = _NEXT_COMMAND.get(said.state) if ended else None
            if verb is not None:
                request = CommandRequest(client_id="benchmark", cycles=cycles - len(results))
                refuse(daemon.command(verb, request))
    typer.echo(json.dumps({**_figures(results), "from_end_to_end_s_median": _apart_s(ended_s)}))


@app.command(name="held")
def held_(
    given: Annotated[
        list[str] | None,
        typer.Option("--set", help="key=value of the station, or paper: its five objects. Repeatable."),
    ] = None,
    objects: Annotated[Path | None, typer.Option(help="A folder of objects, instead of the paper's five.")] = None,
    seeds: Annotated[str, typer.Option(help="N: 1000 to before 1000 + N; or A:B. Below 1000 is to tune on.")] = "1",
    orientations: Annotated[int, typer.Option(min=1, help="Picks of each object alone, each lying otherwise.")] = 1,
    first: Annotated[int | None, typer.Option(min=1, help="Only so many objects of the folder.")] = None,
    bin_: Annotated[int, typer.Option("--bin", min=0, max=30, help="So many dropped into a bin; 0 = each alone.")] = 0,
    pace: Annotated[float, typer.Option(min=0.0, help="1 = real time, which picks an hour by the wall need.")] = 0.0,
    detector: Annotated[
        str, typer.Option(help="onnx:PATH of a grasp network, or a detector of `cell detectors`: shown beside ours.")
    ] = "vlad",
    endpoint: Annotated[str, typer.Option(help="Free loopback endpoint for its cells.")] = "tcp/127.0.0.1:7493",
    jobs: Annotated[int, typer.Option(min=1, help="Seeds at once; each has a cell, at the next port.")] = 1,
    scheduler: Scheduler = "",
    as_json: Annotated[bool, typer.Option("--json", help="Only the figures; progress is on stderr anyway.")] = False,
) -> None:
    """Picks of the whole simulated cell, judged by physics: what truly rose, what the cell said, where the time went.

    The camera is off by 1 mm and 0.3 degrees, in a direction of the seed's. Feasible = held, or a grasp that the oracle
    finds on the true shapes. Each pick is of one object alone on the table, or of a heap in config/bin.toml's bin.
    Another detector is shown beside ours, {"ours": ..., "peer": ...}: same objects, seeds and judge.
    """
    if unknown := [one for one in given or () if "=" not in one and one != "paper"]:
        raise typer.BadParameter(f"{unknown[0]!r} is neither key=value nor paper")
    if objects is not None and "paper" in (given or ()):
        raise typer.BadParameter("either --set paper or --objects")
    if not (detector.startswith(held.NETWORK) or detector in DETECTORS.names()):
        raise typer.BadParameter(f"{detector!r} is none of {', '.join(DETECTORS.names())}, {held.NETWORK}PATH")
    wanted = held.Wanted(
        objects=objects,
        seeds=_seeds(seeds if ":" in seeds else f"1000:{1000 + int(seeds)}" if seeds.isdecimal() else seeds),
        endpoint=endpoint,
        first=first,
        orientations=orientations,
        bin=bin_,
        pace=pace,
        detector=detector,
        overrides=tuple(one for one in given or () if "=" in one),
    )
    typer.echo(json.dumps(held.beside(wanted, say, _crew(jobs, scheduler, with_children=True))))


@app.command(name="alignment")
def alignment_(
    regime: Annotated[str, typer.Option(help="hard or mild")] = "hard",
    trials: Annotated[int, typer.Option(min=1)] = 132,
    seed: int = 0,
    sheet: Annotated[Path | None, typer.Option(help="Where a picture of the first 24 trials goes.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """Every alignment method on the same imagined objects: successes, distances [m], CPU time [ms]."""
    if regime not in REGIMES:
        raise typer.BadParameter(f"{regime!r} is none of {', '.join(REGIMES)}")
    if sheet is not None:
        alignment.contact_sheet(sheet, min(trials, 24), seed, regime)
    typer.echo(json.dumps(alignment.run(regime, trials, seed, tell=_teller(as_json))))


@app.command(name="detect")
def detect_(
    frames: Annotated[int, typer.Option(min=2)] = 97,
    seed: int = 0,
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """Offline detection of 640 x 576 frames: CPU time [ms], memory, and whether the imagined rod comes back."""
    typer.echo(json.dumps(detection.run(frames, seed, _teller(as_json))))


@app.command(name="grasps")
def grasps_(
    dataset: Annotated[str, typer.Option(help="cornell, jacquard, or rgbd")],
    root: Annotated[Path, typer.Option(help="The dataset's folder.")],
    detector: Annotated[str, typer.Option(help="vlad (with antipodal), antipodal, search, or onnx:PATH")] = "vlad",
    sheet: Annotated[Path | None, typer.Option(help="Where a picture goes: of the failures; of all, for rgbd.")] = None,
    masks: Annotated[bool, typer.Option("--masks", help="Jacquard: overlap of segmenters with its masks.")] = False,
    overrides: Annotated[list[str] | None, typer.Option("--set", help="key=value")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """Grasp rectangles on labelled images: the share that matches a label (IoU >= 25 %, 30 degrees), of both halves.

    antipodal: the search on the object's outline alone; vlad: the same through the imagined rod; search: the search
    over a whole scene, on made-up heights.

    rgbd: real frames with depth and without labels, through the whole detection: found, refused by code, CPU time [s].
    """
    if dataset == "rgbd":
        typer.echo(json.dumps(real_frames.run(root, overrides or [], _teller(as_json), sheet)))
        return
    if dataset not in grasps.DATASETS:
        raise typer.BadParameter(f"{dataset!r} is none of {', '.join([*grasps.DATASETS, 'rgbd'])}")
    if not (detector in grasps.DETECTORS or detector.startswith("onnx:")):
        raise typer.BadParameter(f"{detector!r} is none of {', '.join([*grasps.DETECTORS, 'onnx:PATH'])}")
    if masks and dataset != "jacquard":
        raise typer.BadParameter("only jacquard has masks")
    if masks:
        typer.echo(json.dumps(segmenters.overlaps(root, overrides or [], _teller(as_json))))
        return
    typer.echo(json.dumps(grasps.run(dataset, root, detector, overrides or [], _teller(as_json), sheet)))


@app.command(name="scenes")
def scenes_(
    counts: Annotated[list[int] | None, typer.Option("--n", help="Objects in a heap. Repeatable.")] = None,
    views: Annotated[str, typer.Option(help="1, 2 or 3 at once, or auto: as many as the cell wants.")] = "1",
    seeds: Annotated[str, typer.Option(help="A:B, seeds to report on; nothing may be tuned on them.")] = "1000:1100",
    development: Annotated[str, typer.Option(help="A:B, seeds shown beside: those to tune on.")] = "0:30",
    objects: Annotated[Path, typer.Option(help="The folder object_sim.")] = _OBJECTS,
    cache: Annotated[Path | None, typer.Option(help="Where scenes are kept, to measure again in seconds.")] = None,
    jobs: Annotated[int, typer.Option(min=1)] = 1,
    scheduler: Scheduler = "",
    sheet: Annotated[Path | None, typer.Option(help="Where a picture of every scene and its grasp goes.")] = None,
    lifts: Annotated[bool, typer.Option("--lifts", help="Lift each best grasp in simulation, too.")] = False,
    check_judge: Annotated[int, typer.Option(min=0, help="Only lift so many judged grasps of the development.")] = 0,
    given: Annotated[
        list[str] | None,
        typer.Option("--set", help=f"key=value of the station, or what is seen: {', '.join(SETS)}. Repeatable."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """Heaps of real shapes, or single hard things: shares of true and bad grasps, judged on the true shapes.

    With more than one view, what can be picked from any side counts as feasible, and not only from above.
    """
    overrides = tuple(one for one in given or () if "=" in one)
    chosen = [one for one in given or () if "=" not in one] or [HEAPS]
    for name, known in ((views, heaps.LOOKS), *((one, SETS) for one in chosen)):
        if name not in known:
            raise typer.BadParameter(f"{name!r} is none of {', '.join(known)}")
    if HEAPS in chosen and not objects.is_dir():
        typer.echo(json.dumps({"skipped": f"There is no folder {objects}: name object_sim with --objects."}))
        return

    def wanted(group: tuple[str, int], seed: int) -> heaps.Wanted:
        set_name, n = group
        return heaps.Wanted(
            n, seed, objects, cache, overrides, lifted=lifts, set_name=set_name, looks=heaps.LOOKS[views]
        )

    groups = [(name, n) for name in chosen for n in ((counts or heaps.COUNTS) if name == HEAPS else (1,))]
    first, report = _seeds(development), _seeds(seeds)
    if check_judge:
        typer.echo(json.dumps(heaps.check_judge(groups, first, wanted, check_judge)))
    else:
        typer.echo(
            json.dumps(heaps.run(groups, first, report, wanted, _crew(jobs, scheduler), sheet, _teller(as_json)))
        )


@app.command(name="fusion")
def fusion_(
    seeds: Annotated[str, typer.Option(help="A:B, seeds to report on; nothing may be tuned on them.")] = "1000:1030",
    development: Annotated[str, typer.Option(help="A:B, seeds shown beside: those to tune on.")] = "0:10",
    objects: Annotated[Path, typer.Option(help="The folder object_sim.")] = _OBJECTS,
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """Three views fused, the camera off in its mounting: error of the cloud [mm], what the correction mends, CPU [ms].

    Errors are mean and 95th percentile; table or mounting is named from planes alone.
    """
    if not objects.is_dir():
        typer.echo(json.dumps({"skipped": f"There is no folder {objects}: name object_sim with --objects."}))
        return
    typer.echo(json.dumps(fusion.run(_seeds(development), _seeds(seeds), objects, _teller(as_json))))


def _seeds(text: str) -> range:
    """``A:B`` as the seeds from A to before B; empty where they are equal."""
    try:
        first, end = (int(part) for part in text.split(":"))
    except ValueError as error:
        raise typer.BadParameter(f"{text!r} is not of the form A:B, like 0:30") from error
    if end < first:
        raise typer.BadParameter(f"{text!r} ends before it begins: write {end}:{first}")
    return range(first, end)


@app.command(name="models")
def models_(
    scenes: Annotated[int, typer.Option(min=1)] = 48,
    seed: int = 0,
    provider: Annotated[str, typer.Option(help="openai or gemini")] = "openai",
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """Hosted models through the loopback server, drift none, mild and hard: does the carried rectangle survive?"""
    typer.echo(json.dumps(models.run(scenes, seed, provider, _teller(as_json))))


@app.command(name="planning")
def planning_(
    scenes: Annotated[int, typer.Option(min=2, help="Four picks in each.")] = 50,
    seed: int = 0,
    problems: Annotated[
        Path | None, typer.Option(help="Instead: the archive of MotionBenchMaker's Panda problems.")
    ] = None,
    every: Annotated[int, typer.Option(min=1, help="Only every so manyth of them.")] = 1,
    offsets: Annotated[list[int] | None, typer.Option("--offset", help="The first of them. Repeatable.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """Picks among boxes, known or only seen: solved, CPU time [ms], limits, collisions, stops; and plain libraries.

    With --problems the same of moves between two configurations. Nothing may be tuned on an offset to report on.
    """
    if problems is None:
        typer.echo(json.dumps(planning.run(scenes, seed, _teller(as_json))))
    elif not problems.is_file():
        typer.echo(json.dumps({"skipped": f"There is no file {problems}: name the archive with --problems."}))
    else:
        typer.echo(json.dumps(moves.run(problems, every, offsets or [0], _teller(as_json))))


@app.command(name="calibrate")
def calibrate_(
    seeds: Annotated[int, typer.Option(min=1)] = 5,
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """Hand-eye calibration with the simulated camera 15 mm and 3 degrees from where it should be: error left."""
    typer.echo(json.dumps(calibration.run(seeds, _teller(as_json))))


@app.command(name="catalogue")
def catalogue_(
    cycles: Annotated[int, typer.Option(min=1)] = 100_000,
    recording: Annotated[Path | None, typer.Option(help="Of a cycle; default: one of a simulated cell.")] = None,
    endpoint: Annotated[str, typer.Option(help="Free loopback endpoint for its cell.")] = "tcp/127.0.0.1:7492",
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """The catalogue of many cycles: a row inserted, all listed and summed, a query [ms]; recordings read a second."""
    typer.echo(json.dumps(catalogue.run(cycles, endpoint, recording, _teller(as_json))))


@app.command(name="export")
def export_(
    cycles: Annotated[int, typer.Option(min=1)] = 6,
    seed: Annotated[int, typer.Option(help="Below 1000 is to tune on.")] = 1000,
    folder: Annotated[Path | None, typer.Option(help="Recordings; default: of a simulated cell.")] = None,
    endpoint: Annotated[str, typer.Option(help="Free loopback endpoint for its cell.")] = "tcp/127.0.0.1:7491",
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; default: one a core.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """Recordings as data sets: time a GB of them [s], frames, and whether the real LeRobot opens the result."""
    typer.echo(json.dumps(export.run(cycles, seed, folder, endpoint, workers, _teller(as_json))))


@app.command(name="cluster")
def cluster_(
    folder: Annotated[Path, typer.Option(help="Recordings to replay.")] = _CHECKOUT / "tests" / "golden",
    recordings: Annotated[int, typer.Option(min=4, help="So many; fewer are replayed several times.")] = 200,
    workers: Annotated[int, typer.Option(min=2)] = 2,
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """Replays by several processes, one of which is killed: how many times as fast as by one, and the same results."""
    typer.echo(json.dumps(cluster.run(folder, recordings, workers, _teller(as_json))))


@app.command(name="contact")
def contact_(
    tries: Annotated[int, typer.Option(min=1, help="Descents that meet a raised table or a hidden post.")] = 60,
    free: Annotated[int, typer.Option(min=0, help="Descents that meet nothing.")] = 100,
    seed: Annotated[int, typer.Option(help="Below 1000 is to tune on.")] = 1000,
    overrides: Annotated[list[str] | None, typer.Option("--set", help="key=value")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """Guarded approaches: true force [N] and overshoot [mm] at a contact, reflexes, picks held, false alarms."""
    typer.echo(json.dumps(contact.run(tries, free, seed, _teller(as_json), overrides or [])))


@app.command(name="multi-pick")
def multi_pick_(
    tries: Annotated[int, typer.Option(min=1, help="Provoked picks of each kind.")] = 34,
    singles: Annotated[int, typer.Option(min=0, help="Single picks of each kind.")] = 34,
    seed: Annotated[int, typer.Option(help="Below 1000 is to tune on.")] = 1000,
    objects: Annotated[Path | None, typer.Option(help="Folder of objects for the heap; default: no heap.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """More than one thing in the hand: provoked picks that the verdict does not notice, false alarms on single ones."""
    typer.echo(json.dumps({"multi_pick": multi_pick(tries, singles, seed, _teller(as_json), objects)}))


@app.command(name="intruder")
def intruder_(
    tries: Annotated[int, typer.Option(min=1)] = 10_000,
    only: Annotated[list[str] | None, typer.Option(help="One of the kinds. Repeatable; default: all.")] = None,
    seed: int = 1,
    endpoint: Annotated[str, typer.Option(help="Free loopback endpoint for its cell.")] = "tcp/127.0.0.1:7497",
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """Let what should not be on the bus of a running cell ask, forge, pretend and freeze; count what was accepted."""
    for kind in only or ():
        if kind not in intruder.SHARES:
            raise typer.BadParameter(f"{kind!r} is none of {', '.join(intruder.SHARES)}")
    typer.echo(json.dumps(intruder.run(tries, seed, endpoint, _teller(as_json), tuple(only or ()))))


@app.command(name="interfaces")
def interfaces_(
    rounds: Annotated[int, typer.Option(min=10, help="Commands over each protocol.")] = 200,
    contacts: Annotated[int, typer.Option(min=1, help="Descents onto something, and free ones.")] = 20,
    pairs: Annotated[int, typer.Option(min=1, help="Picks of two things at once, of each kind.")] = 2,
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """The doors of a simulated cell, all in one run: from a command to its answer [ms]; and contacts on approach."""
    interfaces = import_module("benchmarks.interfaces.run")  # OPC UA alone takes two seconds to import
    typer.echo(json.dumps(interfaces.run(rounds, contacts, pairs, _teller(as_json))))


@app.command(name="page")
def page_(
    stops: Annotated[int, typer.Option(min=1, help="Picks that are stopped from the page.")] = 20,
    seed: int = 1,
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """The operator's page in a headless browser: first paint, events to the screen, processor time, stop [ms]."""
    operators_page = import_module("benchmarks.operators_page")  # needs playwright
    typer.echo(json.dumps(operators_page.run(stops, seed, _teller(as_json))))


@app.command(name="stop")
def stop_(
    repeats: Annotated[int, typer.Option(min=1, help="Interrupted picks for each trigger.")] = 10,
    only: Annotated[list[str] | None, typer.Option(help="One of the triggers. Repeatable; default: all.")] = None,
    seed: int = 1,
    endpoint: Annotated[str, typer.Option(help="Free loopback endpoint for its cell.")] = "tcp/127.0.0.1:7498",
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """A stop, hold, abort, lost lease, a frozen node, daemon or client in a pick: until brake [ms], and rest [s]."""
    commands, freezes = (*stopping.TRIGGERS, stopping.FROZEN), freezing.TRIGGERS
    for trigger in only or ():
        if trigger not in (*commands, *freezes):
            raise typer.BadParameter(f"{trigger!r} is none of {', '.join((*commands, *freezes))}")
    figures: dict[str, Any] = {}
    for measure, triggers in ((stopping.run, commands), (freezing.run, freezes)):
        if wanted := tuple(trigger for trigger in triggers if trigger in (only or triggers)):
            figures |= measure(repeats, seed, endpoint, _teller(as_json), wanted)
    typer.echo(json.dumps(figures))


@app.command(name="soak")
def soak_(
    cycles: Annotated[int, typer.Option(min=1)] = 1000,
    faults: Annotated[str, typer.Option(help="all, none, or parts separated by commas; node is one, too.")] = "all",
    seed: int = 1,
    state: Annotated[Path | None, typer.Option(help="Progress file: an interrupted run goes on from it.")] = None,
    endpoint: Annotated[str, typer.Option(help="Free loopback endpoint for its cell.")] = "tcp/127.0.0.1:7499",
    overrides: Annotated[list[str] | None, typer.Option("--set", help="key=value")] = None,
    keep: Annotated[Path | None, typer.Option(help="Folder in which all recordings stay: `benchmarks groups`.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Only the figures; progress is on stderr anyway.")] = False,
) -> None:
    """Simulated picks with injected faults: outcomes that docs/faults.md does not allow, cells not ready, leaks."""
    tell = _teller(quiet=False)
    typer.echo(json.dumps(soak.run(cycles, faults, seed, endpoint, state, tell, tuple(overrides or ()), keep)))


@app.command(name="groups")
def groups_(
    state: Annotated[Path, typer.Option(help="Progress file of a soak.")],
    folder: Annotated[Path, typer.Option(help="Its recordings: `benchmarks soak --keep`.")],
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """Failures of a soak in groups: adjusted Rand index between the injected faults and the groups, and sentences."""
    typer.echo(json.dumps(grouped.run(state, folder)))


@app.command(name="bus")
def bus_(
    rounds: Annotated[int, typer.Option(min=10)] = 300,
    seed: int = 1,
    endpoint: Annotated[str, typer.Option(help="Free loopback endpoint for our bus.")] = "tcp/127.0.0.1:7499",
    plain_endpoint: Annotated[str, typer.Option(help="Another for plain Zenoh.")] = "tcp/127.0.0.1:7500",
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """Round trip of a 2.7 MB frame and of a command, and of the same bytes through plain Zenoh: ms, and their ratio."""
    typer.echo(json.dumps(travel.run(rounds, seed, endpoint, plain_endpoint, _teller(as_json))))


@app.command(name="logging")
def logging_(
    seconds: Annotated[float, typer.Option(min=1.0)] = 20.0,
    endpoint: Annotated[str, typer.Option(help="Free loopback endpoint for its cell.")] = "tcp/127.0.0.1:7496",
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """Recording an RGB-D camera at 30 Hz and joints at 100 Hz: CPU, size and losses, by writer."""
    typer.echo(json.dumps(recordings.run(seconds, endpoint, _teller(as_json))))


@app.command(name="torn")
def torn_(
    kills: Annotated[int, typer.Option(min=1)] = 200,
    cells: Annotated[int, typer.Option(min=0, help="How many of them are of a whole simulated cell.")] = 4,
    damages: Annotated[int, typer.Option(min=0, help="How often a recorded cycle is damaged in each way.")] = 100,
    seed: int = 0,
    endpoint: Annotated[str, typer.Option(help="Free loopback endpoint for its cells.")] = "tcp/127.0.0.1:7495",
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """Recordings killed at random moments, or damaged: messages lost of what was flushed, and unreadable files."""
    typer.echo(json.dumps(torn.run(kills, min(cells, kills), damages, seed, endpoint, _teller(as_json))))


@app.command(name="busy")
def busy_(
    starts: Annotated[int, typer.Option(min=1)] = 10,
    cycles: Annotated[int, typer.Option(min=1, help="Picks of each start.")] = 5,
    loops: Annotated[int, typer.Option(min=0, help="Busy processes beside it.")] = 12,
    bare: Annotated[bool, typer.Option(help="Without compiled modules and shaders, as just installed.")] = True,
    endpoint: Annotated[str, typer.Option(help="Free loopback endpoint for its cells.")] = "tcp/127.0.0.1:7494",
    overrides: Annotated[list[str] | None, typer.Option("--set", help="key=value")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """`cell start --cycles N` beside busy loops: starts that succeeded, seconds each, why the others failed."""
    settings = [f"bus.endpoint={endpoint}", *(overrides or [])]
    typer.echo(json.dumps(busy.run(starts, cycles, loops, bare, settings, _teller(as_json))))


@app.command(name="fleet")
def fleet_(
    cells: Annotated[int, typer.Option(min=1)] = 50,
    seconds: Annotated[float, typer.Option(min=0.1)] = 20.0,
    endpoint: Annotated[str, typer.Option(help="Free loopback endpoint for its router.")] = "tcp/127.0.0.1:7499",
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """Light cells on one router, heard as `cell fleet` and a viewer see them: age of every state [ms]."""
    typer.echo(json.dumps(fleet.run(cells, seconds, endpoint, _teller(as_json))))


@app.command(name="house")
def house_(
    root: Annotated[Path, typer.Option(help="Another checkout's folder.", show_default="this one")] = _CHECKOUT,
    as_json: Annotated[bool, typer.Option("--json", help="No progress, only the figures.")] = False,
) -> None:
    """The structure of the code, read and not imported: rooms, arrows, circles, lengths in lines, docstrings."""
    try:
        typer.echo(json.dumps(house.measure(root, _teller(as_json))))
    except (FileNotFoundError, SyntaxError) as error:
        raise typer.BadParameter(str(error)) from error


def _crew(jobs: int, scheduler: str, *, with_children: bool = False) -> Workers:
    """So many processes of this machine, or those of a cluster."""
    return ClusterWorkers(scheduler) if scheduler else LocalWorkers(jobs, with_children)


def _teller(quiet: bool) -> Callable[[str], None]:
    """Progress on stderr."""
    return (lambda line: None) if quiet else say


def _figures(results: list[CycleResult]) -> dict[str, Any]:
    stages = {name for result in results for name in result.stages}
    return {
        "cycles": len(results),
        "by_result": Counter(result.result for result in results),
        "by_code": Counter(str(result.code) for result in results if result.code),
        "failed_objects": Counter(result.object for result in results if result.result != "SUCCESS"),
        "unreadable": [why for result in results if (why := trouble(Path(result.recording)))],
        "wall_s_median": median(result.wall_s for result in results),
        "stage_s_median": {
            name: median(result.stages[name] for result in results if name in result.stages) for name in sorted(stages)
        },
        **cycle_time.figures(results),
    }


def _apart_s(ended_s: list[float]) -> float | None:
    """The median time from one cycle's end to the next one's, with what the cell does between two cycles."""
    apart_s = [after - before for before, after in pairwise(ended_s)]
    return median(apart_s) if apart_s else None


def main() -> None:
    """Errors are one line with advice, as everywhere."""
    try:
        app()
    except CellError as error:
        typer.echo(f"{error.code}: {error}", err=True)
        raise SystemExit(error.exit_code) from error


if __name__ == "__main__":
    main()
