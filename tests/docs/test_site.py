"""The documentation as a site: it builds without a warning, and is complete without a network."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DECISIONS = sorted((ROOT / "docs" / "decisions").glob("*.md"))
HEADS = ["The question", "What was measured", "What was chosen", "When to look again"]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The built site. Strict: a dead link, a missing anchor or a page that nothing leads to is an error."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NO_MKDOCS_2_WARNING", "1")
        config_module = pytest.importorskip("mkdocs.config")
        build = pytest.importorskip("mkdocs.commands.build").build
        folder = tmp_path_factory.mktemp("site")
        logging.getLogger("mkdocs").setLevel(logging.WARNING)
        build(config_module.load_config(str(ROOT / "mkdocs.yml"), site_dir=str(folder)))
        yield folder


def test_it_builds_without_a_warning(site: Path) -> None:
    assert (site / "index.html").exists() and (site / "decisions" / "index.html").exists()


def test_no_page_loads_anything_from_elsewhere(site: Path) -> None:
    loads = re.compile(r'<(?:script|link|img|iframe|source)\b[^>]*\b(?:src|href)="?(https?://[^"\s>]+)')
    found = {(page.name, at) for page in site.rglob("*.html") for at in loads.findall(page.read_text())}
    assert found == set()


@pytest.mark.parametrize("page", [one for one in DECISIONS if one.stem != "README"], ids=lambda page: page.stem)
def test_a_decision_is_one_page_with_its_figure(page: Path) -> None:
    text = page.read_text()
    assert re.findall(r"^## (.*)$", text, re.MULTILINE) == HEADS and len(text.splitlines()) <= 40
    measured = text.partition("## What was measured")[2].partition("## What was chosen")[0]
    assert re.search(r"\d", measured)
    assert f"({page.name})" in page.with_name("README.md").read_text()
