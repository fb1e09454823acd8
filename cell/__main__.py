"""The command line, ``cell --help``. Exits: 0 done, 1 robot failed, 2 usage or config, 3 refused, 4 unreachable."""

from __future__ import annotations

import logging
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

from bus.errors import CellError
from cell import calibrate, fleet, keys, nodes, recordings, replays, verbs
from cell import watch as watching
from cell.doctor import examine
from cell.options import Config, Json, Set, out, print_json
from cell.start import start
from config.load import DEFAULT_STATION, load_station

app = typer.Typer(
    help="VLAD Cell: picks objects it has never seen, explains every pick, and can replay it.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    epilog="Exit codes: 0 done, 1 the robot failed (code printed), 2 usage or configuration, 3 refused, 4 unreachable.",
)
app.add_typer(calibrate.app, name="calibrate")

app.command()(start)
app.command()(verbs.pick)
for verb, help_text, until in verbs.SIMPLE:
    app.command(verb, help=help_text)(verbs.simple(verb, until))
app.command()(verbs.status)


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
        print_json([member.to_json() for member in members])
        return
    for member in members:
        out.print(member.line(time.time_ns()), style="red" if member.problems else "")
    if not members:
        out.print("No cell can be seen from here.")


@app.command()
def router(
    config: Annotated[Path, typer.Option("--config", "-c", help="Zenoh file, e.g. the router.json5 of `cell keys`.")],
) -> None:
    """Run a Zenoh router, where cells and those who look after them meet; zenohd does the same with the same file."""
    fleet.route(config, out.print)


@app.command("keys")
def keys_(
    folder: Annotated[Path, typer.Argument(help="Where to; outside of this project.")],
    hosts: Annotated[
        list[str] | None, typer.Option("--host", help="Address or name of the cell or the router. Repeatable.")
    ] = None,
) -> None:
    """Make TLS certificates and Zenoh files for every role: cell, router, node, operator, viewer (docs/security.md)."""
    written = keys.make_keys(folder, hosts or [])
    out.print("\n".join(str(path) for path in written))
    out.print("A machine of a role gets ca.pem and that role's .pem, .key and .json5. ca.key stays here.")


app.command()(recordings.recover)
app.command()(replays.replay)
app.command()(recordings.report)
app.command()(recordings.show)
app.command()(recordings.cycles)


@app.command("config")
def show_config(config: Config = DEFAULT_STATION, overrides: Set = None) -> None:
    """Print the whole configuration, defaults included, as JSON."""
    print_json(load_station(config, overrides or []).model_dump_json(indent=2))


@app.command()
def doctor(config: Config = DEFAULT_STATION, overrides: Set = None, as_json: Json = False) -> None:
    """Check this machine and the station's devices before the first start. Exit 0 nothing to fix, 1 something is."""
    if not examine.report(load_station(config, overrides or []), out, as_json=as_json):
        raise typer.Exit(1)


app.command()(verbs.fault)


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
            print_json(
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
