"""``cell opcua``: serve a running cell over OPC UA; make a user of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bus.lazy import LazyModule
from cell.cli.options import Config, Set
from cell.cli.serving.doors import Supervised, serve_door
from cell.opcua.needs import require_package
from cell.opcua.passwords import ROLES, new_user
from cell.terminal.printing import err, out
from config.load import DEFAULT_STATION, load_station
from config.schema import Station

if TYPE_CHECKING:
    from cell.opcua import door
else:
    door: Any = LazyModule("cell.opcua.door")  # imports asyncua


def opcua(
    config: Config = DEFAULT_STATION,
    user: Annotated[
        str | None,
        typer.Option(help="Make a user instead: print the line for opcua.users, and the password.", metavar="NAME"),
    ] = None,
    role: Annotated[str, typer.Option(help="Role of that user: operator, or viewer.")] = "operator",
    overrides: Set = None,
    supervised: Supervised = False,
) -> None:
    """Serve the running cell over OPC UA, as a PackML machine; what clients commanded is held when they go."""
    if user is not None:
        _make_user(user, role)
        return
    serve_door("OPC UA", _serve, lambda: load_station(config, overrides or []), is_supervised=supervised)


def _serve(station: Station, tell: Callable[[str], None], wait_for_end: Callable[[], None]) -> None:
    require_package()
    door.serve(station, tell, wait_for_end)


def _make_user(name: str, role: str) -> None:
    """Print the user's line, and on stderr the password, so that the line alone can be appended to the file."""
    if role not in ROLES:
        raise typer.BadParameter(f"a role is one of {', '.join(ROLES)}.", param_hint="--role")
    if not name or not name.isprintable() or any(sign.isspace() for sign in name) or name.startswith("#"):
        raise typer.BadParameter("a name is one word.", param_hint="--user")
    password, line = new_user(name, role)
    out.line(line)
    err.line(f"The password of {name}, shown only here: {password}")
