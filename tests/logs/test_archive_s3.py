"""An archive on S3: the server is moto's, from an environment of its own (`uv tool install "moto[server,s3]"`)."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from bus.errors import ArchiveError
from logs.archive import Archive

pytestmark = pytest.mark.thorough
_START_S = 30.0


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The address of an empty bucket on a server of this machine."""
    pytest.importorskip("s3fs", reason="vlad-cell[archive] is not installed: nothing is tested on S3")
    program = shutil.which(os.environ.get("MOTO_SERVER", "moto_server"))
    if program is None:
        pytest.skip("there is no moto_server, here or in MOTO_SERVER: nothing is tested on S3")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    url = f"http://127.0.0.1:{port}"
    for name, value in (("ENDPOINT_URL", url), ("ACCESS_KEY_ID", "test"), ("SECRET_ACCESS_KEY", "test")):
        monkeypatch.setenv(f"AWS_{name}", value)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    server = subprocess.Popen(
        [program, "-H", "127.0.0.1", "-p", str(port)],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        _make_bucket(url, time.monotonic() + _START_S)
        yield "s3://recordings/cell-1"
    finally:
        server.terminate()
        server.wait(10)


def _make_bucket(url: str, until_s: float) -> None:
    while time.monotonic() < until_s:
        with suppress(OSError):
            urllib.request.urlopen(urllib.request.Request(f"{url}/recordings", method="PUT"), timeout=5).close()
            return
        time.sleep(0.1)
    raise TimeoutError("moto_server does not answer")


def test_a_recording_is_copied_to_s3_and_read_back(bucket: str, tmp_path: Path) -> None:
    path = tmp_path / "one.mcap"
    path.write_bytes(os.urandom(3_000_000))
    archive = Archive(bucket)
    copy = archive.put(path, "2026-01-01/one.mcap")
    assert copy.address == f"{bucket}/2026-01-01/one.mcap"
    assert Archive(bucket).put(path, "2026-01-01/one.mcap") == copy, "it is there, and equal"
    path.write_bytes(b"another")
    with pytest.raises(ArchiveError, match="Another file"):
        archive.put(path, "2026-01-01/one.mcap")


def test_a_bucket_that_is_not_there_is_said(bucket: str, tmp_path: Path) -> None:
    path = tmp_path / "one.mcap"
    path.write_bytes(b"recorded")
    with pytest.raises(ArchiveError, match="cannot be copied"):
        Archive(bucket.replace("recordings", "absent")).put(path, "one.mcap")
    assert path.exists()
