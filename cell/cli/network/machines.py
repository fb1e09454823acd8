"""``cell fleet``, ``router``, ``keys``: cells and operators on other machines."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from cell.cli.network import fleet as seen
from cell.cli.network.opcua_keys import make_opcua_keys
from cell.cli.network.tls_keys import make_keys
from cell.cli.options import Config, Json, Set
from cell.terminal.printing import out
from config.load import DEFAULT_STATION, load_station


def fleet(
    config: Config = DEFAULT_STATION,
    endpoint: Annotated[
        str | None, typer.Option(help="Where to look: a router's or a cell's endpoint (= --set bus.endpoint).")
    ] = None,
    overrides: Set = None,
    as_json: Json = False,
) -> None:
    """Show every cell that can be seen from here: state, stage, since when, why, and what is wrong with it."""
    extra = [f"bus.endpoint={endpoint}"] if endpoint is not None else []
    options = {"bus.endpoint": "--endpoint"} if extra else {}
    members = seen.fleet(load_station(config, [*(overrides or []), *extra], given_by=options))
    if as_json:
        out.json([member.to_json() for member in members])
        return
    for member in members:
        out.line(member.line(time.time_ns()), style="red" if member.problems else "")
    if not members:
        out.line("No cell can be seen from here.")


def router(
    config: Annotated[Path, typer.Option("--config", "-c", help="Zenoh file, e.g. the router.json5 of `cell keys`.")],
) -> None:
    """Run a Zenoh router, where cells and those who look after them meet; zenohd does the same with the same file."""
    seen.route(config, out.line)


def keys(
    folder: Annotated[Path, typer.Argument(help="Where to; outside of this project.")],
    hosts: Annotated[
        list[str] | None, typer.Option("--host", help="Address or name of the cell or the router. Repeatable.")
    ] = None,
    opcua: Annotated[
        bool, typer.Option("--opcua", help="Instead: certificates for OPC UA, of the cell and one client.")
    ] = False,
) -> None:
    """Make TLS certificates and Zenoh files for each role: cell, router, node, operator, viewer (docs/security.md)."""
    written = make_opcua_keys(folder, hosts or []) if opcua else make_keys(folder, hosts or [])
    for path in written:
        out.line(str(path))
    if opcua:
        out.line("The client gets client.pem, client-key.pem and cell.pem. What lies in trusted may connect.")
        return
    out.line("A machine of a role gets ca.pem and that role's .pem, .key and .json5. ca.key stays here.")
