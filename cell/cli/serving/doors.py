"""The doors that ``cell start`` opens beside the cell, and what their own commands share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from typing import Annotated

import typer

from cell.http.needs import require as require_http
from cell.nodes.door_child import Serve, serve_supervised, serve_until_interrupted
from cell.nodes.doors import Door, HealthNews, News
from cell.opcua.needs import require_package as require_asyncua
from cell.terminal.printing import out
from config.schema import Station

Supervised = Annotated[bool, typer.Option("--supervised", hidden=True, help="Serve the station on stdin.")]
"""How the cell starts a door as its child."""
_NEEDS: dict[str, Callable[[Station], None]] = {"opcua": lambda station: require_asyncua(), "http": require_http}
"""Door, which is also the name of its command and settings -> check of what it needs. Raises: ConfigError."""


def wanted_doors(station: Station, *named: str) -> list[str]:
    """Return the doors of the options, and those that the station enables. Raises: ConfigError when one cannot open."""
    doors = [name for name in _NEEDS if name in named or getattr(station, name).enabled]
    for name in doors:
        _NEEDS[name](station)
    return doors


@contextmanager
def open_doors(
    station: Station, names: list[str], on_news: News, on_health: HealthNews = lambda name, health: None
) -> Iterator[None]:
    """Context with these doors of a running cell; they open in the background, and tell when they have."""
    with ExitStack() as stack:
        for name in names:
            stack.enter_context(closing(Door(name, station, on_news, on_health=on_health).start()))
        yield


def serve_door(name: str, serve: Serve, load: Callable[[], Station], *, is_supervised: bool) -> None:
    """Serve a door in this process, in a terminal or as the cell's child.

    Args:
        load: reads the station of the command line; not called for a child.

    Raises: typer.Exit with the code of a child; as `serve`.
    """
    if is_supervised:
        raise typer.Exit(serve_supervised(serve))
    serve_until_interrupted(serve, load(), lambda where: out.line(f"{name}: {where}; Ctrl-C ends"))
