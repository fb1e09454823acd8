"""Progress of a measurement; a module of its own, because workers import it."""

from __future__ import annotations

import typer


def say(line: str) -> None:
    """A line on stderr."""
    typer.echo(line, err=True)
