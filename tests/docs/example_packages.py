"""The packages of examples/, as an installer leaves them: importable, and with what says what they bring."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from tests.dist_info import write_dist_info

EXAMPLES = Path(__file__).parents[2] / "examples"
PACKAGES = ("hand_driver", "goal_model", "detector")


def information(folder: Path, name: str, more: str = "") -> Path:
    """Write what an installer says of the example into ``folder``: its entry points, and ``more`` lines. Returns it."""
    project = tomllib.loads((EXAMPLES / name / "pyproject.toml").read_text())["project"]
    points = {
        group: [*(f"{point} = {target}" for point, target in named.items()), more]
        for group, named in project["entry-points"].items()
    }
    write_dist_info(folder, project["name"], project["version"], points)
    return folder


def install(patch: pytest.MonkeyPatch, folder: Path, *names: str, more: str = "") -> None:
    """Make the examples importable in this process, as if they were installed."""
    for name in names:
        patch.syspath_prepend(EXAMPLES / name)
        information(folder, name, more)
    patch.syspath_prepend(folder)
