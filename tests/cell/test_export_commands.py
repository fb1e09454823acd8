"""``cell export lerobot`` and ``cell export grasps`` as an operator uses them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from bus.errors import ConfigError
from cell.cli.commands import command_line

pytest.importorskip("av")
pytest.importorskip("pyarrow")
GOLDEN = Path(__file__).parents[1] / "golden"


@pytest.fixture
def recordings(tmp_path: Path) -> str:
    """A pick, a failed cycle, and one whose file is torn."""
    folder = tmp_path / "recordings"
    folder.mkdir()
    for name in ("cycle-schema3", "cycle-schema4"):
        shutil.copy(GOLDEN / f"{name}.mcap", folder)
    (folder / "torn.mcap").write_bytes((GOLDEN / "cycle-schema4.mcap").read_bytes()[:100_000])
    return str(folder)


def _cell(*arguments: str) -> Result:
    return CliRunner().invoke(command_line(), ("export", *arguments))


@pytest.mark.parametrize("kind", ["lerobot", "grasps"])
def test_all_that_can_be_read_is_exported_and_the_rest_named(kind: str, recordings: str, tmp_path: Path) -> None:
    done = _cell(kind, recordings, "-o", str(tmp_path / "set"), "--json")
    said = json.loads(done.stdout)
    assert done.exit_code == 2 and "DAMAGED" in done.stderr and "torn.mcap" in done.stderr
    assert said["episodes" if kind == "lerobot" else "cycles"] == 2 and len(said["left_out"]) == 1
    assert isinstance(_cell(kind, recordings, "-o", str(tmp_path / "set")).exception, ConfigError)


@pytest.mark.parametrize("kind", ["lerobot", "grasps"])
def test_only_the_chosen_cycles_are_exported(kind: str, recordings: str, tmp_path: Path) -> None:
    done = _cell(kind, recordings, "-o", str(tmp_path / "set"), "--where", "result = 'SUCCESS'")
    assert done.exit_code == 0 and done.stderr == ""
    assert done.stdout.startswith(f"{tmp_path / 'set'}: 1 ")
