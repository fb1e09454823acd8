"""The command line: which command is in which module. Only what is asked for is imported: `cell stop` must not wait."""

from __future__ import annotations

from importlib import import_module

import typer

_MODULES = {
    "start": "start",
    **dict.fromkeys(("pick", "reset", "stop", "abort", "clear", "hold", "unhold", "suspend", "unsuspend"), "verbs"),
    "status": "verbs",
    "watch": "station",
    **dict.fromkeys(("fleet", "router", "keys"), "elsewhere"),
    **dict.fromkeys(("cycles", "show", "report"), "recordings"),
    "replay": "replays",
    "recover": "recordings",
    **dict.fromkeys(("config", "doctor"), "station"),
    "calibrate": "calibrate",
    "fault": "verbs",
    "node": "station",
}
"""Command -> module of this room, in which it is the function (or the Typer of several) of that name."""


def command_line(first: str | None = None) -> typer.Typer:
    """The application ``cell``.

    Args:
        first: what its user typed first. A known command is imported alone; otherwise all are.
    """
    app = typer.Typer(
        help="VLAD Cell: picks objects it has never seen, explains every pick, and can replay it.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode="rich",
        epilog=(
            "Exit codes: 0 done, 1 the robot failed (code printed), 2 usage or configuration, 3 refused, 4 unreachable."
        ),
    )
    app.callback()(lambda: None)  # a group, also when it has one command
    for name in (first,) if first in _MODULES else _MODULES:
        command = getattr(import_module(f"cell.{_MODULES[name]}"), name)
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name)
        else:
            app.command(name)(command)
    return app
