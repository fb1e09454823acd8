"""Writes docs/commands.md from the commands' own help: ``uv run python -m docs.commands_page``."""

from __future__ import annotations

import re
from pathlib import Path

import typer
from typer.cli import get_docs_for_click

from cell.cli.commands import COMMANDS, command_line

PAGE = Path(__file__).with_name("commands.md")
_EXAMPLES = re.compile(r"\x08\nExamples:\n((?:  .*\n)+)")


def page() -> str:
    """The page's text, without markup of a terminal or of HTML."""
    command = typer.main.get_command(command_line())
    text = get_docs_for_click(obj=command, ctx=typer.Context(command), name="cell", title="Commands")
    for name, row in COMMANDS.items():
        text = re.sub(
            rf"^\* `{name}`: .*$", f"* [`{name}`](#cell-{name}): {row.help}", text, count=1, flags=re.MULTILINE
        )
    return f"{_EXAMPLES.sub(_block, text).strip()}\n"


def _block(examples: re.Match[str]) -> str:
    lines = "\n".join(f"$ {line.strip()}" for line in examples[1].strip().splitlines())
    return f"**Examples**:\n\n```console\n{lines}\n```\n"


if __name__ == "__main__":
    PAGE.write_text(page())
