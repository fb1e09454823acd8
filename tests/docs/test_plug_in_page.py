"""docs/plug_ins.md: what a plug-in imports of ours; the packages of examples/ import nothing else."""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from config.load import load_station
from docs import plug_in_page
from docs.plug_in_imports import SECTIONS
from tests.docs.example_packages import EXAMPLES, PACKAGES
from vlad_cell.testing.__main__ import with_its_node

LISTED = {(module, name) for section in SECTIONS for module, names in section.imports.items() for name in names}
OURS = ("bus", "cell", "config", "drivers", "logs", "perception", "planning", "vlad_cell")


def imported(file: Path) -> Iterator[tuple[str, str]]:
    """Module and name of everything of ours that a file imports."""
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in OURS:
            yield from ((node.module, one.name) for one in node.names)
        if isinstance(node, ast.Import):
            yield from ((one.name, "") for one in node.names if one.name.split(".")[0] in OURS)


def test_the_page_is_written_from_the_docstrings() -> None:
    assert plug_in_page.PAGE.read_text() == plug_in_page.page(), "run: just docs"


@pytest.mark.parametrize("package", PACKAGES)
def test_an_example_imports_only_what_the_page_lists(package: str) -> None:
    found = {one for file in (EXAMPLES / package).glob("*.py") for one in imported(file)}
    assert found and found <= LISTED


@pytest.mark.parametrize("package", PACKAGES)
def test_an_example_names_the_version_that_it_was_tried_with(package: str) -> None:
    """As docs/extend.md asks of every plug-in."""
    version = tomllib.loads((EXAMPLES.parent / "pyproject.toml").read_text())["project"]["version"]
    project = tomllib.loads((EXAMPLES / package / "pyproject.toml").read_text())["project"]
    assert project["dependencies"] == [f"vlad-cell ~= {version}"]
    assert project["optional-dependencies"]["testing"] == [f"vlad-cell[testing] ~= {version}"]


def test_the_page_shows_the_whole_pyproject_of_an_example() -> None:
    assert (EXAMPLES / "detector" / "pyproject.toml").read_text() in (
        EXAMPLES.parent / "docs" / "extend.md"
    ).read_text()


def test_the_checks_take_a_driver_s_settings_on_the_command_line_as_cell_start_does() -> None:
    """Without a station file that names the driver."""
    station = load_station(None, with_its_node("driver", "acme", None, ["nodes.hand.settings.port=/dev/null"]))
    assert station.nodes["hand"].driver == "acme" and station.nodes["hand"].settings == {"port": "/dev/null"}
    kept = ["nodes.sim.settings.x=1", "sim.pace=1"]
    assert sorted(with_its_node("driver", "sim", None, kept)) == sorted(kept), (
        "a node that the station has stays as it is"
    )
    assert with_its_node("detector", "acme", None, ["perception.settings.x=1"]) == ["perception.settings.x=1"]
