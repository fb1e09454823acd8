"""A file is written at once or not at all, and stays what it was besides."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from bus.atomic import write_atomically, written_atomically


def _mode(path: Path) -> int:
    return path.stat().st_mode & 0o777


def test_a_file_gets_its_new_content_and_keeps_its_mode(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_bytes(b"old")
    path.chmod(0o600)
    write_atomically(path, b"new")
    assert path.read_bytes() == b"new"
    assert _mode(path) == 0o600
    assert os.listdir(tmp_path) == ["lab.toml"]


@pytest.mark.parametrize("umask", [0o000, 0o077])
def test_an_asked_for_mode_holds_whatever_the_umask(tmp_path: Path, umask: int) -> None:
    before = os.umask(umask)
    try:
        write_atomically(tmp_path / "page.html", b"", mode=0o640)
        write_atomically(tmp_path / "new.toml", b"")
    finally:
        os.umask(before)
    assert _mode(tmp_path / "page.html") == 0o640
    assert _mode(tmp_path / "new.toml") == 0o644


def test_a_folder_that_cannot_be_written_is_told_by_the_name_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="Not a directory") as failure:
        write_atomically(tmp_path / "file" / "lab.toml", b"")
    assert failure.value.filename == str(tmp_path / "file" / "lab.toml")


def test_a_symbolic_link_stays_one_and_its_target_is_written(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    target, link = tmp_path / "real" / "lab.toml", tmp_path / "lab.toml"
    link.symlink_to(target)
    for content in (b"first", b"second"):  # a link to nothing yet, then to a file
        write_atomically(link, content)
        assert link.is_symlink()
        assert target.read_bytes() == content


def test_a_name_that_is_as_long_as_names_get_is_written(tmp_path: Path) -> None:
    write_atomically(tmp_path / ("n" * 255), b"new")


def test_somebody_elses_part_file_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "lab.toml.part").write_bytes(b"theirs")
    write_atomically(tmp_path / "lab.toml", b"new")
    assert (tmp_path / "lab.toml.part").read_bytes() == b"theirs"


def test_a_file_written_piece_by_piece_is_there_when_its_block_ends(tmp_path: Path) -> None:
    path = tmp_path / "cycle.mcap"
    with written_atomically(path, mode=0o640) as output:
        output.write(b"one,")
        output.write(b"two")
        assert not path.exists()
    assert path.read_bytes() == b"one,two" and _mode(path) == 0o640


def test_a_block_that_raises_leaves_the_folder_as_it_was(tmp_path: Path) -> None:
    with pytest.raises(KeyError), written_atomically(tmp_path / "cycle.mcap") as output:
        output.write(b"half")
        raise KeyError
    assert os.listdir(tmp_path) == []


def test_a_failed_write_leaves_the_folder_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "lab.toml").mkdir()  # cannot be replaced by a file
    with pytest.raises(OSError, match="directory"):
        write_atomically(tmp_path / "lab.toml", b"new")
    assert os.listdir(tmp_path) == ["lab.toml"]
