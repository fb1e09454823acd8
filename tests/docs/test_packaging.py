"""What the wheel holds: every package of the product, and every file of data that it opens."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TOOLS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]
TOP = tuple(TOOLS["importlinter"]["root_packages"])
FIND = TOOLS["setuptools"]["packages"]["find"]
FORMS = [form for forms in TOOLS["setuptools"]["package-data"].values() for form in forms]


@pytest.mark.parametrize("top", TOP)
def test_every_folder_with_code_is_a_package_of_the_wheel(top: str) -> None:
    """setuptools takes what ``include`` names and has an ``__init__.py``."""
    assert {top, f"{top}.*"} <= set(FIND["include"]) and FIND["namespaces"] is False
    folders = {folder for file in (ROOT / top).rglob("*.py") for folder in file.relative_to(ROOT).parents[:-1]}
    assert [folder for folder in folders if not (ROOT / folder / "__init__.py").exists()] == []


def test_every_file_of_data_is_in_the_wheel() -> None:
    files = {file for top in TOP for file in (ROOT / top).rglob("*.*") if file.is_file()}
    packages = {file.parent for file in files if file.name == "__init__.py"}
    taken = {file for one in packages for form in FORMS for file in one.glob(form)}
    assert [file for file in files - taken if file.suffix not in (".py", ".pyc")] == []
