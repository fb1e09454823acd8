"""docs/commands.md is what the commands say of themselves, and every example is a command that there is."""

from __future__ import annotations

import pytest
import typer

from cell.cli.commands import COMMANDS, command
from cell.cli.examples import EXAMPLES
from docs.commands_page import PAGE, page
from tests.docs.command_lines import Line, problems


def test_the_page_of_the_commands_is_written_from_their_own_help() -> None:
    assert PAGE.read_text() == page(), "run: just docs"


def test_the_page_is_plain_markdown_without_entities_of_html() -> None:
    assert "&lt;" not in page() and "&#" not in page() and "\x08" not in page()


def test_every_command_has_examples() -> None:
    inner = {f"{name} {one}" for name in COMMANDS for one in getattr(command(name), "commands", {})}
    assert set(EXAMPLES) == {*COMMANDS, *inner}


@pytest.mark.parametrize("example", [one for lines in EXAMPLES.values() for one in lines])
def test_an_example_is_understood(example: str) -> None:
    """Options, arguments and their forms are; nothing is carried out."""
    assert example.startswith("cell ") and problems(Line(example)) == []


def test_the_help_of_a_command_shows_its_examples() -> None:
    text = command("pick").get_help(typer.Context(command("pick")))
    assert text.rstrip().endswith(EXAMPLES["pick"][-1])
