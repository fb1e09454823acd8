"""docs/commands.md is what the commands say of themselves."""

from __future__ import annotations

from docs.commands_page import PAGE, page


def test_the_page_of_the_commands_is_written_from_their_own_help() -> None:
    assert PAGE.read_text() == page(), "run: just docs"


def test_the_page_is_plain_markdown_without_entities_of_html() -> None:
    assert "&lt;" not in page() and "&#" not in page()
