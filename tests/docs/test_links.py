"""Every link inside the documentation leads somewhere."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.md")])
_LINK = re.compile(r"\]\((?!https?:)([^)\s]*)\)")


def anchors(page: Path) -> set[str]:
    """As GitHub makes them of the page's headlines."""
    heads = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_pages_links_lead_somewhere(page: Path) -> None:
    for link in _LINK.findall(page.read_text()):
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


_PATH = re.compile(
    r"(?<![\w/.~-])((?:bus|cell|config|drivers|logs|perception|planning|benchmarks|stand_ins|tests|docs|packaging|examples)"
    r"/[\w./@-]*\w)"
)
_MADE_UP = {"config/mine.toml"}
"""What a reader makes; names in capital letters are the reader's, too."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_file_of_the_code_that_a_page_names_exists(page: Path) -> None:
    named = {name for name in _PATH.findall(page.read_text()) if not re.search(r"[A-Z]{2}", name)} - _MADE_UP
    keys = {name for name in named if name.startswith("cell/") and "." not in name}  # of the bus, or a room
    files = [name for name in named - keys if not (page.parent / name).exists()]
    assert [name for name in files if not (ROOT / name).exists() and not (ROOT / f"{name}.py").exists()] == []
