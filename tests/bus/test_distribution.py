"""The name of our distribution has one owner: the versions in recordings and of plug-ins are looked up by it."""

from __future__ import annotations

import tomllib
from pathlib import Path

from bus.distribution import OURS

ROOT = Path(__file__).parents[2]
PACKAGES = ("bus", "cell", "config", "drivers", "logs", "perception", "planning", "vlad_cell")


def test_it_is_what_the_package_is_built_as_and_no_other_module_spells_it() -> None:
    assert tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["name"] == OURS
    modules = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    spelt = [path for path in modules if f'"{OURS}"' in path.read_text() or f"'{OURS}'" in path.read_text()]
    assert [str(path.relative_to(ROOT)) for path in spelt] == ["bus/distribution.py"]
