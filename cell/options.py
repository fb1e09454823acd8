"""What the commands share: their options, and how they print what a program reads."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

Config = Annotated[Path, typer.Option("--config", "-c", help="Station file.", show_default="the simulated cell")]
Set = Annotated[list[str] | None, typer.Option("--set", help="Override one setting: key=value. Repeatable.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON for programs.")]

out = Console(highlight=False, soft_wrap=True)


def print_json(value: Any) -> None:
    """One line of JSON; text is taken to be JSON already."""
    out.out(json.dumps(value) if not isinstance(value, str) else value, highlight=False)
