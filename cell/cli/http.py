"""``cell http``: serves a running cell over HTTP, in a process of its own."""

from __future__ import annotations

import sys
from typing import Annotated, Any

import typer

from bus.lazy import LazyModule
from cell.cli.options import Config, Set
from cell.http.needs import require_packages
from cell.nodes.door_child import serve_supervised, serve_until_interrupted
from cell.terminal.printing import out
from config.load import DEFAULT_STATION, load_station
from config.schema import Station

server: Any = LazyModule("cell.http.server")  # only where the packages are


def http(
    config: Config = DEFAULT_STATION,
    overrides: Set = None,
    supervised: Annotated[bool, typer.Option("--supervised", hidden=True)] = False,
) -> None:
    """Serve a running cell over HTTP, until Ctrl-C: JSON, events, recordings and reports (docs/http.md)."""
    if supervised:
        sys.exit(serve_supervised(_serve))
    serve_until_interrupted(_serve, load_station(config, overrides or []), _say_where)


def _serve(station: Station, tell: Any, wait_for_end: Any) -> None:
    require_packages()
    server.serve(station, tell, wait_for_end)


def _say_where(url: str) -> None:
    out.line(f"{url}/api lists what is served; Ctrl-C ends it")
