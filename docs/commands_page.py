"""Writes docs/commands.md from the commands' own help: ``uv run python -m docs.commands_page``."""

from __future__ import annotations

from pathlib import Path

import typer
from typer.cli import get_docs_for_click

from cell.cli.commands import command_line

PAGE = Path(__file__).with_name("commands.md")


def page() -> str:
    """The page's text, without markup of a terminal or of HTML."""
    command = typer.main.get_command(command_line())
    text = get_docs_for_click(obj=command, ctx=typer.Context(command), name="cell", title="Commands")
    return f"{text.strip()}\n"


if __name__ == "__main__":
    PAGE.write_text(page())
