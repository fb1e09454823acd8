"""What the how-to pages write into a station file fits the files that they begin with, and their commands name them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from config.load import load_station
from config.new_station import Kind, new_station
from tests.docs.command_lines import ROOT

_LINES = re.compile(r"```toml\n(.*?)```", re.DOTALL)
_COMMANDS = re.compile(r"^uv run cell .*", re.MULTILINE)


@pytest.mark.parametrize("kind", [Kind.SIMULATED, Kind.BIN, Kind.ROBOT])
@pytest.mark.parametrize("page", ["howto/place.md", "howto/objects.md", "use.md"])
def test_lines_of_a_page_fit_at_the_end_of_a_new_file(page: str, kind: Kind, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(new_station("mine", kind) + "".join(_LINES.findall((ROOT / "docs" / page).read_text())))
    station = load_station(file)
    assert station.scene.places or station.perception.labels


def test_every_command_about_a_place_with_a_name_names_the_file_that_has_it() -> None:
    _, _, named = (ROOT / "docs" / "howto" / "place.md").read_text().partition("Places with names")
    commands = _COMMANDS.findall(named)
    assert len(commands) == 5 and all("mine.toml" in one for one in commands)
