"""`setup.sh` on machines where something is in the way. A stand-in of `uv` makes an environment that holds nothing."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
UV = """#!/bin/sh
[ "$1" != venv ] || { mkdir -p .venv/bin && cp -P /bin/true .venv/bin/python; }
case "$*" in *"pip sync"*) exit "${NO_NETWORK:-0}" ;; esac
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A folder with what `setup.sh` reads, and that `uv`."""
    folder = tmp_path / "my büro's cell"
    folder.mkdir()
    for name in ("setup.sh", "requirements.lock", "pyproject.toml"):
        shutil.copy(ROOT / name, folder)
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "uv").write_text(UV)
    (tmp_path / "bin" / "uv").chmod(0o755)
    return folder


def _setup(folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    path = f"{folder.parent / 'bin'}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, **environment}
    return subprocess.run(["./setup.sh"], cwd=folder, env=environment, capture_output=True, text=True, check=False)


def test_the_second_run_has_nothing_to_do(checkout: Path) -> None:
    assert "done" in _setup(checkout).stdout
    assert _setup(checkout).stdout == ""


@pytest.mark.parametrize("way", [shutil.move, shutil.copytree])
def test_a_folder_that_was_moved_or_copied_gets_an_environment_of_its_own(checkout: Path, way: object) -> None:
    _setup(checkout)
    assert callable(way)
    elsewhere = Path(way(checkout, checkout.with_name("elsewhere")))
    (elsewhere / ".venv" / "of the old folder").touch()
    said = _setup(elsewhere).stdout
    assert "moved or copied" in said and "done" in said
    assert not (elsewhere / ".venv" / "of the old folder").exists()


def test_an_environment_that_is_a_link_is_left_alone(checkout: Path) -> None:
    _setup(checkout)
    other = checkout.with_name("other")
    shutil.copytree(checkout, other, ignore=shutil.ignore_patterns(".venv"))
    (other / ".venv").symlink_to(checkout / ".venv")
    assert _setup(other).stdout == ""


def test_without_a_network_it_says_what_is_missing_and_tries_again(checkout: Path) -> None:
    refused = _setup(checkout, NO_NETWORK="1")
    assert refused.returncode == 2
    assert "Without a network" in refused.stderr
    assert "done" in _setup(checkout).stdout
