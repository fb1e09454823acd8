"""``cell doctor``, ``watch``, ``node``: inspect and serve one station."""

from __future__ import annotations

from typing import Annotated

import typer

from cell.cli.options import Config, Json, Set
from cell.cli.picks import watch as watching
from cell.doctor import examine
from cell.nodes import child
from cell.terminal.printing import out
from config.load import DEFAULT_STATION, load_station


def doctor(config: Config = DEFAULT_STATION, overrides: Set = None, as_json: Json = False) -> None:
    """Check this machine and the station's devices before the first start. Exit 0 nothing to fix, 1 something is."""
    if not examine.report(load_station(config, overrides or []), config, out, as_json=as_json):
        raise typer.Exit(1)


def watch(
    config: Config = DEFAULT_STATION,
    overrides: Set = None,
    once: Annotated[bool, typer.Option("--once", help="Print the view once and end.")] = False,
) -> None:
    """Show the running cell on one screen: state, last cycles, nodes; each command is one key. q ends the view."""
    watching.watch(load_station(config, overrides or []), once=once)


def node(
    name: Annotated[str, typer.Argument(help="Node of the station file.")],
    config: Config = DEFAULT_STATION,
    overrides: Set = None,
) -> None:
    """Serve one driver node on the bus (for nodes with run = "elsewhere"; the daemon runs the others)."""
    child.serve_until_interrupted(name, load_station(config, overrides or []))
