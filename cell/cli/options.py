"""Options shared by the commands, and the checks of their values before anything is done."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

_LONGEST_NAME = 100
"""Longest object name on the bus (`bus.commands.CommandRequest`)."""


def object_name_of(name: str | None) -> str | None:
    """An object's name that fits into a command. Raises: typer.BadParameter."""
    if name is not None:
        try:
            name.encode()
        except UnicodeEncodeError as error:
            raise typer.BadParameter(f"{name!r} is not UTF-8.") from error
        if len(name) > _LONGEST_NAME:
            raise typer.BadParameter(f"a name has at most {_LONGEST_NAME} characters, this one {len(name)}.")
    return name


def finite(number: float | None) -> float | None:
    """A finite number, or None; its unit is the option's. Raises: typer.BadParameter for NaN and infinity."""
    if number is not None and not math.isfinite(number):
        raise typer.BadParameter(f"{number} is no finite number.")
    return number


Config = Annotated[
    Path,
    typer.Option("--config", "-c", metavar="FILE.toml", help="Station file.", show_default="the simulated cell"),
]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override one setting, as in sim.pace=1. Repeatable."),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON for programs.")]
Count = Annotated[
    int | None,
    typer.Option(
        "--workers",
        min=1,
        max=256,
        help="Of a folder: so many processes; 1 = this one alone.",
        show_default="one a core, fewer for a few recordings",
    ),
]
Scheduler = Annotated[
    str,
    typer.Option(help="Of a folder: work on the Dask cluster of this scheduler, tcp://HOST:PORT (vlad-cell[cluster])."),
]
