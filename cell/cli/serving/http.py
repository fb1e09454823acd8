"""``cell http``: serve a running cell over HTTP."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from bus.lazy import LazyModule
from cell.cli.options import Config, Set
from cell.cli.serving.doors import Supervised, serve_door
from cell.http.needs import require
from config.load import DEFAULT_STATION, load_station
from config.schema import Station

if TYPE_CHECKING:
    from cell.http import server
else:
    server: Any = LazyModule("cell.http.server")  # only where the packages are


def http(config: Config = DEFAULT_STATION, overrides: Set = None, supervised: Supervised = False) -> None:
    """Serve the running cell over HTTP: JSON, events, files; what clients commanded is held when they go."""
    serve_door("HTTP", _serve, lambda: load_station(config, overrides or []), is_supervised=supervised)


def _serve(station: Station, tell: Callable[[str], None], wait_for_end: Callable[[], None]) -> None:
    require(station)
    server.serve(station, tell, wait_for_end)
