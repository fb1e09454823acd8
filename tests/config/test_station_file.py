"""A new camera mounting in a station file: only that changes, and the old values stay readable."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path

import pytest

from bus.errors import ConfigError
from config.station_file import require_writable, with_mounting, write_mounting

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


WAYS = {
    "plain": BEFORE,
    "dotted": "camera.max_age_s = 2.0\ncell_id = 'x'\ncamera.hand_from_color_wxyz = [1, 0,\n 0, 0]  # was\n",
    "dotted, none": "camera.max_age_s = 2.0\n[nodes.sim]\ndriver = 'sim'\n",
    "inline": "a = 1\ncamera = { max_age_s = 2.0, hand_from_color_wxyz = [1, 0, 0, 0] }  # all\n[b]\nc = 1\n",
    "several lines": "[ camera ] # k\n  # c\n  'hand_from_color_wxyz' = [ # k\n  1,\n  0, 0, 0]\n\n# d\n[b]\nc = 1",
    "empty": "",
    "only a header": "[camera]",
    "in a text": 'a = """\n[camera]\nhand_from_color_wxyz = 1\n"""\n# end',
    "another's": "[nodes.camera]\nhand_from_color_wxyz = [1]\n",
    "odd letters": "# Prüfzelle\u2028Linie\n[camera] # \u0085\nhand_from_color_wxyz = [1] # \u2028x\nmax_age_s = 1",
}


@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
@pytest.mark.parametrize("mark", ["", "\ufeff"], ids=["", "marked"])
@pytest.mark.parametrize("way", WAYS)
def test_however_it_is_written_every_other_line_stays_in_its_order(way: str, mark: str, line_end: str) -> None:
    before = mark + WAYS[way].replace("\n", line_end)
    after = with_mounting(before, POSITION_M, WXYZ, "today")
    camera = tomllib.loads(after.removeprefix(mark))["camera"]
    assert camera["hand_from_color_position_m"] == list(POSITION_M)
    assert camera["hand_from_color_wxyz"] == list(WXYZ)
    rest = iter(after.splitlines())
    for line in before.removeprefix(mark).splitlines():
        assert any(line.strip() in each for each in rest), line
    assert after.count("today") == 1
    assert after.count("\n") == after.count(line_end) or "\n" not in before
    assert after.endswith(line_end) == before.endswith(line_end)
    assert after.startswith(mark)


@pytest.mark.parametrize("way", WAYS)
def test_calibrating_again_and_again_only_adds_lines(way: str) -> None:
    text = WAYS[way]
    for index in range(3):
        text, before = with_mounting(text, (0.01 * index, 0.0, 0.0), WXYZ, f"number {index}"), text
        assert all(line.strip() in text for line in before.splitlines())


def test_a_link_stays_a_link_and_the_file_keeps_its_mode_and_line_ends(tmp_path: Path) -> None:
    target, link, stranger = tmp_path / "real.toml", tmp_path / "lab.toml", tmp_path / "lab.part"
    target.write_bytes(BEFORE.replace("\n", "\r\n").encode())
    target.chmod(0o600)
    link.symlink_to(target)
    stranger.write_text("somebody's")
    write_mounting(link, POSITION_M, WXYZ, "today")
    assert link.is_symlink() and b"# today\r\n" in target.read_bytes()
    assert target.stat().st_mode & 0o777 == 0o600
    assert stranger.read_text() == "somebody's" and len(list(tmp_path.iterdir())) == 3


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("# Prüfzelle\n".encode("latin-1"), r"not UTF-8 text \(line 1\)"),
        (b"# a\x0cb\n", "not valid TOML"),
        ("cell_id = 'x'".encode("utf-16"), "not UTF-8 text"),
        (b"cell_id = \n", "not valid TOML"),
    ],
)
def test_what_cannot_be_edited_is_told_before_and_again_with_the_lines_to_copy(
    tmp_path: Path, content: bytes, says: str
) -> None:
    path = tmp_path / "station.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=says):
        require_writable(path)
    with pytest.raises(ConfigError, match=says) as caught:
        write_mounting(path, POSITION_M, WXYZ, "today")
    assert tomllib.loads(caught.value.advice.split("\n", 1)[1])["camera"]["hand_from_color_position_m"] == list(
        POSITION_M
    )
    assert path.read_bytes() == content and list(tmp_path.iterdir()) == [path]


def test_a_file_that_cannot_be_written_is_said_before_anything_moves(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no station file"):
        require_writable(tmp_path / "none.toml")
    path = tmp_path / "lab.toml"
    path.write_text(BEFORE)
    require_writable(path)
    (tmp_path / "twin.toml").hardlink_to(path)
    with pytest.raises(ConfigError, match="2 names"):
        require_writable(path)
    (tmp_path / "twin.toml").unlink()
    path.chmod(0o444)
    with pytest.raises(ConfigError, match="read-only"):
        require_writable(path)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(ConfigError, match="no regular file"):
        require_writable(pipe)
    assert path.read_text() == BEFORE
