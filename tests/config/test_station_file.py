"""A new camera mounting in a station file: only that changes, and the old values stay readable."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from bus.errors import ConfigError
from config.station_file import with_mounting, write_mounting

POSITION_M, WXYZ = (0.07, 0.001, 0.021), (0.7071068, 0.0, 0.0, 0.7071068)
BEFORE = """# my cell
cell_id = "a"   # its name

[camera]
# measured with a rule
hand_from_color_position_m = [0.065, 0.0, 0.02]  # roughly
hand_from_color_wxyz = [0.70710678118654752, 0.0, 0.0, 0.70710678118654752]
max_age_s = 3.0

[nodes.sim]
driver = "sim"
"""


def test_only_the_mounting_changes_and_the_old_one_stays_as_a_comment() -> None:
    after = with_mounting(BEFORE, POSITION_M, WXYZ, "calibrated today, 0.3 px")
    old, new = tomllib.loads(BEFORE), tomllib.loads(after)
    assert new["camera"].pop("hand_from_color_position_m") == list(POSITION_M)
    assert new["camera"].pop("hand_from_color_wxyz") == pytest.approx(WXYZ)
    del old["camera"]["hand_from_color_position_m"], old["camera"]["hand_from_color_wxyz"]
    assert new == old
    assert "# calibrated today, 0.3 px" in after
    assert "# before: hand_from_color_position_m = [0.065, 0.0, 0.02]  # roughly" in after
    assert after.startswith('# my cell\ncell_id = "a"   # its name\n') and after.endswith('driver = "sim"\n')


def test_a_file_without_a_camera_table_gets_one() -> None:
    after = with_mounting('cell_id = "a"\n', POSITION_M, WXYZ, "today")
    assert tomllib.loads(after) == {
        "cell_id": "a",
        "camera": {"hand_from_color_position_m": list(POSITION_M), "hand_from_color_wxyz": list(WXYZ)},
    }


def test_calibrating_twice_keeps_both_older_values() -> None:
    once = with_mounting(BEFORE, POSITION_M, WXYZ, "first")
    twice = with_mounting(once, (0.08, 0.0, 0.0), WXYZ, "second")
    assert tomllib.loads(twice)["camera"]["hand_from_color_position_m"] == [0.08, 0.0, 0.0]
    assert "# first" in twice and "# second" in twice
    assert twice.count("# before: hand_from_color_position_m") == 2


def test_a_table_written_in_another_way_is_refused_and_the_file_stays(tmp_path: Path) -> None:
    path = tmp_path / "station.toml"
    path.write_text("camera = { max_age_s = 3.0 }\n")
    with pytest.raises(ConfigError, match="Copy the printed lines"):
        write_mounting(path, POSITION_M, WXYZ, "today")
    assert path.read_text() == "camera = { max_age_s = 3.0 }\n"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be written"):
        write_mounting(tmp_path / "none.toml", POSITION_M, WXYZ, "today")
