"""A copy counts when what is read back is what was sent; nothing that is there is replaced."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from bus.errors import ArchiveError, ConfigError
from logs.archive import Archive

fsspec = pytest.importorskip("fsspec", reason="vlad-cell[archive] is not installed")
_Memory: Any = pytest.importorskip("fsspec.implementations.memory").MemoryFileSystem


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "20260101T120000000.mcap"
    file.write_bytes(b"recorded" * 1000)
    return file


def test_it_is_copied_below_the_address_and_read_back(path: Path, tmp_path: Path) -> None:
    archive = Archive(f"file://{tmp_path}/nas/cell-1")
    copy = archive.put(path, "2026-01-01/one.mcap")
    there = tmp_path / "nas" / "cell-1" / "2026-01-01" / "one.mcap"
    assert copy.address == f"file://{there}" and there.read_bytes() == path.read_bytes()
    assert [one.name for one in there.parent.iterdir()] == ["one.mcap"]
    assert archive.put(path, "2026-01-01/one.mcap") == copy, "what is there is compared"


def test_another_file_of_that_name_is_not_replaced(path: Path, tmp_path: Path) -> None:
    archive = Archive(str(tmp_path / "nas"))
    archive.put(path, "one.mcap")
    path.write_bytes(b"another")
    with pytest.raises(ArchiveError, match="stays"):
        archive.put(path, "one.mcap")
    assert (tmp_path / "nas" / "one.mcap").read_bytes() == b"recorded" * 1000


def test_what_an_upload_that_was_cut_short_left_is_sent_again(path: Path, tmp_path: Path) -> None:
    (tmp_path / "nas").mkdir()
    (tmp_path / "nas" / "one.mcap.part").write_bytes(b"recor")
    Archive(str(tmp_path / "nas")).put(path, "one.mcap")
    assert [one.name for one in (tmp_path / "nas").iterdir()] == ["one.mcap"]


class _Flips(_Memory):  # type: ignore[misc]
    """A store that takes a file and keeps another: a checksum that it is sent would not tell."""

    protocol = "flips"
    store: dict[str, object] = {}  # noqa: RUF012 - as in the class it stands for

    def put_file(self, lpath: str, rpath: str, **_: object) -> None:
        self.pipe_file(rpath, Path(lpath).read_bytes()[:-1] + b"?")


def test_a_store_that_keeps_something_else_is_found_out(path: Path) -> None:
    fsspec.register_implementation("flips", _Flips, clobber=True)
    with pytest.raises(ArchiveError, match="What is read back"):
        Archive("flips://cell").put(path, "one.mcap")
    assert path.exists()


@pytest.mark.parametrize(
    ("address", "said"), [("nonsense://x", "no address"), ("gs://bucket/x", r"vlad-cell\[archive\]")]
)
def test_an_address_that_cannot_be_used_is_refused_at_once(address: str, said: str) -> None:
    with pytest.raises(ConfigError) as error:
        Archive(address)
    assert said.replace("\\", "") in str(error.value)
