"""docs/architecture.md names what there is: every file, every room in its order, every role of a thread."""

from __future__ import annotations

import re
import tomllib
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from bus.threads import Role

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "architecture.md"
DRAWING = PAGE.with_suffix(".svg")
TEXT = PAGE.read_text()
PACKAGES = ("vlad_cell", "cell", "drivers", "perception", "planning", "logs", "config", "bus")
BESIDE = ("stand_ins", "benchmarks")
_PATH = re.compile(rf"\b(?:{'|'.join((*PACKAGES, *BESIDE, 'docs'))})/[\w./]*")


def table(head: str) -> list[list[str]]:
    """The rows of the table that begins with the line ``head``, cell by cell."""
    lines = TEXT.partition(head)[2].splitlines()[2:]
    rows = lines[: next(number for number, line in enumerate(lines) if not line.startswith("|"))]
    return [[part.strip() for part in row.strip("|").split("|")] for row in rows]


ROOMS = [row[0].strip("`").rstrip("/") for row in table("| room | what it does")]


@pytest.mark.parametrize("page", [PAGE, DRAWING], ids=lambda page: page.name)
def test_every_file_and_folder_it_names_exists(page: Path) -> None:
    named = {path.rstrip("./") for path in _PATH.findall(page.read_text())}
    assert named and not [path for path in sorted(named) if not (ROOT / path).exists()]


def test_every_room_is_in_its_table_once() -> None:
    rooms = [folder.parent for package in PACKAGES for folder in sorted((ROOT / package).rglob("__init__.py"))]
    expected = {str(room.relative_to(ROOT)) for room in rooms} - {"cell", "drivers"}  # their files are named one by one
    assert {room for room in ROOMS if (ROOT / room).is_dir()} == expected
    assert len(set(ROOMS)) == len(ROOMS)


@pytest.mark.parametrize("package", BESIDE)
def test_every_room_beside_the_product_is_named(package: str) -> None:
    rooms = [folder.parent for folder in (ROOT / package).rglob("__init__.py")]
    assert [room for room in rooms if f"`{room.relative_to(ROOT)}/`" not in TEXT] == []


def contracts() -> list[tuple[str, list[list[str]]]]:
    """The layers of each contract of import-linter: the package they are in, and its rooms from top to bottom."""
    settings: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layered = [one for one in settings["contracts"] if one["type"] == "layers"]
    return [
        (one.get("containers", [""])[0], [[part.strip() for part in layer.split("|")] for layer in one["layers"]])
        for one in layered
    ]


@pytest.mark.parametrize(("package", "layers"), contracts(), ids=lambda value: value if isinstance(value, str) else "")
def test_the_table_goes_down_as_the_contracts_do(package: str, layers: list[list[str]]) -> None:
    def places(layer: list[str]) -> list[int]:
        paths = {f"{package}/{room}".lstrip("/") for room in layer}
        return [
            number
            for number, room in enumerate(ROOMS)
            if any(room in (path, f"{path}.py") or (not package and room.startswith(f"{path}/")) for path in paths)
        ]

    in_table = [found for layer in layers if (found := places(layer))]
    assert len(in_table) > 1
    for higher, lower in pairwise(in_table):
        assert max(higher) < min(lower)


def test_every_role_of_a_thread_has_a_row() -> None:
    assert {row[0].strip("`") for row in table("| role | in | owner")} == {role.name for role in Role}


@pytest.mark.parametrize("row", table("| role | in | owner"), ids=lambda row: row[0].strip("`"))
def test_a_thread_is_started_where_its_row_says(row: list[str]) -> None:
    owners = re.findall(r"`([\w/]+\.py)`", row[2])
    assert owners and all(f"Role.{row[0].strip('`')}" in (ROOT / owner).read_text() for owner in owners)


def test_every_thread_of_the_product_is_started_by_an_owner_of_the_table() -> None:
    named = {owner for row in table("| role | in | owner") for owner in re.findall(r"`([\w/]+\.py)`", row[2])}
    files = [file for package in PACKAGES for file in (ROOT / package).rglob("*.py")]
    starts = {str(file.relative_to(ROOT)) for file in files if "OwnedThread(Role." in file.read_text()}
    assert starts == named
