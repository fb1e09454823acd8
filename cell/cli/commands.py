"""The table of commands and their modules. Only the requested command is imported, so that `cell stop` starts fast."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from bus.distribution import OURS
from bus.lazy import LazyModule
from cell.cli.examples import shown
from cell.terminal.printing import out

metadata: Any = LazyModule("importlib.metadata")


class Row(NamedTuple):
    """One command: the module of this package that holds it, as a function or a Typer of its name, and its short help.

    The help is the first paragraph of the command's own (checked by a test); showing it imports nothing.
    """

    module: str
    help: str


COMMANDS = {
    "start": Row(
        "serving.start",
        "Start the cell: the daemon and its nodes. Without --cycles or --until-empty it stays, and waits for commands.",
    ),
    "tour": Row(
        "serving.tour",
        "Show three cycles of a simulated cell: one succeeds, one must fail, one asks what if; each with its page.",
    ),
    "pick": Row(
        "picks.pick",
        "Pick one object, and wait for the result. The cell must be Idle or Complete; if this ends early, it holds.",
    ),
    "run": Row(
        "picks.pick",
        "Let the running cell pick several times, and wait. It must be Idle; if this ends early, it holds.",
    ),
    "reset": Row("picks.control", "Self-check, arm to the capture pose; ends in Idle."),
    "stop": Row(
        "picks.control", "Controlled stop: brake on the path, confirm by the measured velocity; ends in Stopped."
    ),
    "abort": Row("picks.control", "Brake now; ends in Aborted. Then: clear, reset, start - three deliberate acts."),
    "clear": Row("picks.control", "Clear an abort; ends in Stopped."),
    "hold": Row("picks.control", "Pause a running cycle: brake on the path and wait there; ends in Held."),
    "unhold": Row("picks.control", "Go on with a held cycle; returns when it runs again."),
    "suspend": Row("picks.control", "Pause for a reason outside the cell; brakes as hold does; ends in Suspended."),
    "unsuspend": Row("picks.control", "Go on with a suspended cycle; returns when it runs again."),
    "cancel": Row("picks.control", "Cancel a job that waits, or whose grasp has not begun: nothing of it moves then."),
    "approve": Row(
        "picks.control",
        "Approve the planned pick that waits (execute.approve): the arm moves. Shows it, and asks first.",
    ),
    "next-grasp": Row(
        "picks.control", "Pass over the grasp that waits for approval: the next feasible one is planned, and waits."
    ),
    "reject": Row(
        "picks.control",
        "Reject the planned pick that waits for approval: its cycle ends REJECTED, and is not tried again.",
    ),
    "mode": Row(
        "picks.by_hand",
        "Set the mode of the unit: in manual the arm is moved by hand, in production it picks. Manual stops the cell.",
    ),
    "jog": Row(
        "picks.by_hand", "In mode manual: move the tcp straight by small steps. Ctrl-C ends it within one step."
    ),
    "jog-home": Row(
        "picks.by_hand", "In mode manual: move slowly to the capture pose, around the known boxes. Ctrl-C ends it."
    ),
    "hand-open": Row("picks.by_hand", "In mode manual: open the hand."),
    "hand-close": Row("picks.by_hand", "In mode manual: close the hand on what is there."),
    "status": Row("picks.control", "Show the machine's state, what it would accept, and how its nodes and doors are."),
    "watch": Row(
        "station.setup",
        "Show the running cell on one screen: state, last cycles, nodes; each command is one key. q ends the view.",
    ),
    "fleet": Row(
        "network.machines",
        "Show every cell that can be seen from here: state, stage, since when, why, and what is wrong with it.",
    ),
    "router": Row(
        "network.machines",
        "Run a Zenoh router, where cells and those who look after them meet; zenohd does the same with the same file.",
    ),
    "keys": Row(
        "network.machines",
        "Make TLS certificates and Zenoh files for each role: cell, router, node, operator, viewer (docs/security.md).",
    ),
    "cycles": Row("recorded.cycles", "List recorded cycles, newest first, or sum them up."),
    "query": Row(
        "recorded.catalogue", "Ask the catalogue of recorded cycles in SQL; it can only be read (docs/catalogue.md)."
    ),
    "label": Row(
        "recorded.catalogue", "Say of a recorded cycle that it was good or bad, or note something; kept beside it."
    ),
    "show": Row(
        "recorded.show", "Show why a cycle ended so: its result, what to do, its stages, what was changed for it."
    ),
    "report": Row(
        "recorded.show",
        "Write one HTML page that explains a cycle; of a folder, a page per cycle and one a day.",
    ),
    "replay": Row(
        "recorded.replay",
        "Run the pure stages again from recordings and compare. Exit 0 equal, 1 different, 2 cannot.",
    ),
    "compare": Row(
        "recorded.compare",
        "Compare two cycles stage by stage: input, decision, outcome; or two folders, by code and object (95 %).",
    ),
    "alike": Row(
        "recorded.alike",
        "Show the past cycles nearest to one, by what was seen and what happened; 0 = no difference (docs/alike.md).",
    ),
    "groups": Row(
        "recorded.alike", "Failures in groups, the largest first: a sentence and three examples each (docs/alike.md)."
    ),
    "recover": Row(
        "recorded.show",
        "Make torn recordings whole. Exit 0 all that was flushed is kept, 1 something is lost, 2 cannot.",
    ),
    "catalogue": Row("recorded.catalogue", "The catalogue: one row a recorded cycle, made of the recordings."),
    "prune": Row(
        "recorded.prune",
        "Trim and delete recordings by the rule of the station (recording.keep_gb and others), archived before.",
    ),
    "export": Row("recorded.export", "Chosen recordings as a data set of another program."),
    "config": Row(
        "station.config",
        "A station file: what counts and where it comes from, its mistakes, differences, a schema, a new one.",
    ),
    "doctor": Row(
        "station.setup",
        "Check this machine and the station's devices before the first start. Exit 0 nothing to fix, 1 something is.",
    ),
    "detectors": Row(
        "station.plug_ins",
        "List the detectors that a station can name (perception.detector), the package of each, and its settings.",
    ),
    "drivers": Row(
        "station.plug_ins",
        "List the drivers that a station can name (nodes.NAME.driver), the package of each, and its settings.",
    ),
    "goal-models": Row(
        "station.plug_ins",
        "List the goal-image models that a station can name (perception.model), the package of each, and its settings.",
    ),
    "calibrate": Row("station.calibrate", "Where the camera sits in the hand: find it, check it."),
    "fault": Row(
        "picks.control",
        "Tell a part of a running cell to misbehave, to see what it does: docs/faults.md. Needs faults.allowed = true.",
    ),
    "opcua": Row(
        "serving.opcua",
        "Serve the running cell over OPC UA, as a PackML machine; what clients commanded is held when they go.",
    ),
    "http": Row(
        "serving.http",
        "Serve the running cell over HTTP: JSON, events, files; what clients commanded is held when they go.",
    ),
    "node": Row(
        "station.setup",
        'Serve one driver node on the bus (for nodes with run = "elsewhere"; the daemon runs the others).',
    ),
}
"""The commands in the order in which they are shown."""

_FACE: dict[str, Any] = {"add_completion": False, "pretty_exceptions_enable": False, "rich_markup_mode": None}


class Commands(TyperGroup):
    """The commands of the table; each is imported on request."""

    _only_named = False

    def __init__(self, **attributes: Any) -> None:
        named = {name: TyperCommand(name, help=row.help) for name, row in COMMANDS.items()}
        super().__init__(**{**attributes, "commands": named})

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command, imported; only its name and short help while listing. None for an unknown name."""
        named = super().get_command(ctx, cmd_name)
        return named if named is None or self._only_named else command(cmd_name)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help from the table, without importing the commands."""
        with self._named_only():
            super().format_help(ctx, formatter)

    def shell_complete(self, ctx: Any, incomplete: str) -> Any:
        """Complete from the table, without importing the commands."""
        with self._named_only():
            return super().shell_complete(ctx, incomplete)

    @contextmanager
    def _named_only(self) -> Iterator[None]:
        """Context in which a command consists of its name and short help."""
        self._only_named = True
        try:
            yield
        finally:
            self._only_named = False


def command(name: str) -> Any:
    """Return the command of the table, imported."""
    what = getattr(import_module(f"cell.cli.{COMMANDS[name].module}"), name.replace("-", "_"))
    app = what
    if not isinstance(what, typer.Typer):
        app = typer.Typer(**_FACE)
        app.command(name)(what)
    made: Any = get_command(app)
    made.name = name
    made.epilog = shown(name)
    for inner, below in getattr(made, "commands", {}).items():
        below.epilog = shown(f"{name} {inner}")
    return made


def command_line() -> typer.Typer:
    """Return the application ``cell``."""
    app = typer.Typer(
        cls=Commands,
        help="VLAD Cell: picks objects it has never seen, explains every pick, and can replay it.",
        no_args_is_help=True,
        epilog=(
            "Exit codes: 0 done, 1 the robot failed (code printed), 2 usage or configuration, 3 refused,"
            " 4 unreachable, 5 a defect of this program."
        ),
        **{**_FACE, "add_completion": True},
    )

    @app.callback()
    def _cell(
        _: Annotated[
            bool, typer.Option("--version", callback=_say_version, is_eager=True, help="Print the version, and end.")
        ] = False,
    ) -> None: ...

    return app


def _say_version(wanted: bool) -> None:
    if wanted:
        out.line(f"cell {metadata.version(OURS)}{_commit()}")
        raise typer.Exit


def _commit() -> str:
    """`` (commit 0123abc)`` in a checkout, with a + for local changes; "" elsewhere, or without git."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return ""
    described = ["git", "-C", str(root), "describe", "--always", "--abbrev=12", "--dirty=+", "--exclude=*"]
    try:
        said = subprocess.run(described, check=True, capture_output=True, text=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
    return f" (commit {said})"
