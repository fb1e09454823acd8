"""``cell tour``: a pick that succeeds, one that must fail, and a what-if, each with its page and what to look at."""

from __future__ import annotations

import webbrowser
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from bus.commands import CellState, CommandRequest
from bus.errors import NotReached
from bus.free_port import free_endpoint
from bus.messages import CycleResult, Job, Target
from cell.build import running_cell
from cell.cli.serving.console import Screen
from cell.daemon.daemon import Daemon
from cell.machine.owner import refuse
from cell.machine.states import ENDED, told
from cell.replay.replay import Request, replay
from cell.replay.view import show_what_if
from cell.replay.what_if import what_if
from cell.terminal.printing import out
from cell.terminal.signals import on_end
from config.load import load_station
from logs.mcap.reader import read_cycle
from logs.report.cycle_report import write_report

_CLIENT = "tour"
_OBJECT, _ABSENT = "spatula", "purple"
_NARROW = "hand.max_width_m=0.021"
_FIRST = """
1. A pick that succeeds. The camera looks, a rod is imagined through the spatula, the arm takes it to the tray."""
_LOOK_AT_FIRST = """\
   On its page: "What it saw" and "What it imagined" (the rod in the goal image), the yellow rectangle of the grasp,
   the motion against the arm's limits, and what the hand felt."""
_SECOND = f"""
2. A pick that must fail: the {_ABSENT} one is asked for, and there is none. No other object is taken for it."""
_LOOK_AT_SECOND = """\
   On its page: the first line says what was there instead. Nothing moved: the cycle ended in detect."""
_THIRD = """
3. What if? The first cycle once more, from its recording, with a hand that opens 21 mm and not 80. Nothing moves."""
_LOOK_AT_THIRD = """\
   On its page: another grasp, on the thin neck. Everything else is as it was recorded, so only the hand can be why."""
_END = """
The same by hand: `cell show CYCLE` (why did it end so), `cell replay FILE --set KEY=VALUE -o page.html` (what if?),
`cell cycles` (all of them). The pages, in a browser:"""


def tour(
    folder: Annotated[Path, typer.Option(help="Where the recordings and pages go.")] = Path("recordings"),
    open_it: Annotated[bool, typer.Option("--open", help="Open the pages in the browser.")] = False,
) -> None:
    """Show three cycles of a simulated cell: one succeeds, one must fail, one asks what if; each with its page."""
    settings = ["sim.seed=1", f"recording.folder={folder}", f"bus.endpoint={free_endpoint()}"]
    screen = Screen(json_lines=False, report=True)
    on_end(screen.interrupted.set, insists=True)
    out.line("A simulated cell: less than two minutes, no network, nothing real moves.")
    with running_cell(load_station(None, settings), screen.observe) as daemon:
        heard = screen.follow(quiet=True)
        _reset(daemon, heard)
        picks = screen.follow()
        _say(_FIRST)
        held = _pick(daemon, picks, CommandRequest(client_id=_CLIENT, object=_OBJECT))
        _say(_LOOK_AT_FIRST)
        _say(_SECOND)
        absent = Job(target=Target(text=_ABSENT))
        failed = _pick(daemon, picks, CommandRequest(client_id=_CLIENT, job=absent))
        _say(_LOOK_AT_SECOND)
    _say(_THIRD)
    recording = Path(held.recording)
    asked = _what_if(recording)
    _say(_LOOK_AT_THIRD)
    _say(_END)
    pages = [recording.with_suffix(".html"), Path(failed.recording).with_suffix(".html"), asked]
    for page in pages:
        out.line(f"  {page.resolve().as_uri()}")
        if open_it:
            webbrowser.open(page.resolve().as_uri())


def _reset(daemon: Daemon, heard: Iterator[object]) -> None:
    """Until the cell is Idle. Raises: NotReached when it ended elsewhere, and after Ctrl-C."""
    refuse(daemon.command("reset", CommandRequest(client_id=_CLIENT)))
    is_under_way = False  # what is heard first is that it was Stopped
    for said in heard:
        if isinstance(said, CellState) and said.state == "Idle":
            return
        is_under_way = is_under_way or (isinstance(said, CellState) and said.state == "Resetting")
        if is_under_way:
            _require_goes_on(said)
    raise NotReached("Interrupted before the cell was Idle.", "Run it again: `cell tour`.")


def _pick(daemon: Daemon, heard: Iterator[object], request: CommandRequest) -> CycleResult:
    """One pick to its end. Raises: NotReached when the cell ended before it, and after Ctrl-C."""
    refuse(reply := daemon.command("pick", request))
    awaited, last = reply.cycle_id, None
    for said in heard:
        if isinstance(said, CycleResult) and said.cycle_id == awaited:
            awaited, last = said.retried_as, said
        elif last is not None and not awaited and isinstance(said, CellState) and said.state == "Complete":
            return last
        _require_goes_on(said)
    raise NotReached("Interrupted before the pick was over.", "Run it again: `cell tour`.")


def _require_goes_on(said: object) -> None:
    """Raises: NotReached when the cell says that it is stopped or aborted."""
    if isinstance(said, CellState) and said.state in ENDED:
        why = told(said.state, said.reason)
        raise NotReached(f"The cell is {said.state}: {why}", "Is the machine able to (`cell doctor`)? Run it again.")


def _what_if(recording: Path) -> Path:
    """The page of the recording with a hand that opens less, beside it; what changes is printed."""
    request = Request.of([_NARROW], None, None)
    outcome = replay(read_cycle(recording), request)
    show_what_if(outcome, out)
    page = write_report(what_if(outcome, request.overrides), recording.with_suffix(".what-if.html"))
    out.line(f"  report    {page}")
    return page


def _say(text: str) -> None:
    for line in text.splitlines():
        out.line(line)
