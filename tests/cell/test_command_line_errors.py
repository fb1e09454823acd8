"""Bad input: one clear line with advice, the right exit code, no traceback."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

Run = Callable[..., subprocess.CompletedProcess[str]]


def _process(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """As a user runs it."""
    return subprocess.run(
        [sys.executable, "-m", "cell", *arguments],
        capture_output=True,
        text=True,
        timeout=90,
        check=False,
        env={**os.environ, **environment},
    )


def _says(done: subprocess.CompletedProcess[str], code: int, *words: str) -> None:
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr + done.stdout
    (line,) = done.stderr.strip().splitlines()
    for word in words:
        assert word in line


def test_an_unknown_key_is_named_with_its_neighbour(in_process: Run, options: list[str]) -> None:
    _says(in_process("start", "--set", "sim.pase=1", *options), 2, "sim.pase", "'pace'")


def test_a_missing_station_file(in_process: Run) -> None:
    _says(in_process("start", "--config", "absent.toml"), 2, "absent.toml", "--config")


def test_an_unknown_driver_lists_the_installed_ones(in_process: Run, options: list[str]) -> None:
    _says(in_process("start", "--set", "nodes.sim.driver=warp", *options), 2, "warp", "sim")


def test_a_folder_without_objects(in_process: Run, options: list[str], tmp_path: Path) -> None:
    _says(in_process("start", "--objects", str(tmp_path), *options), 2, str(tmp_path), "object.xml")


def test_a_folder_named_like_a_number_is_a_folder(in_process: Run, options: list[str]) -> None:
    _says(in_process("start", "--objects", "2026", *options), 2, "No object in 2026", "object.xml")


def test_a_folder_whose_name_is_no_utf8(in_process: Run, options: list[str]) -> None:
    _says(in_process("start", "--objects", os.fsdecode(b"caf\xe9"), *options), 2, "sim.objects", "not UTF-8")


def test_a_port_that_is_none_is_no_occupied_one(in_process: Run) -> None:
    _says(in_process("start", "--set", "bus.endpoint=tcp/127.0.0.1:99999"), 2, "bus.endpoint", "99999")


def test_a_station_file_that_cannot_be_written_is_said_before_the_arm_moves(in_process: Run, tmp_path: Path) -> None:
    path = tmp_path / "station.toml"
    path.write_text('[nodes.sim]\ndriver = "none of them"\nserves = ["camera", "arm", "hand"]\n')
    path.chmod(0o444)
    _says(in_process("calibrate", "hand-eye", "--config", str(path)), 2, str(path), "read-only", "--dry-run")


def test_no_egl(options: list[str]) -> None:
    done = _process("start", "--cycles", "1", *options, MUJOCO_EGL_DEVICE_ID="99")
    _says(done, 2, "apt-get install", "libegl1")


def test_an_occupied_port(in_process: Run, options: list[str], endpoint: str) -> None:
    host, port = endpoint.removeprefix("tcp/").split(":")
    with socket.create_server((host, int(port))):
        _says(in_process("start", "--cycles", "1", *options), 4, endpoint, "cell status")


def test_no_cell_to_talk_to(in_process: Run, options: list[str]) -> None:
    _says(in_process("status", *options), 4, "cell start")


@pytest.mark.parametrize("command", ["replay", "report", "show"])
@pytest.mark.parametrize("content", [None, b"", b"not an MCAP", b"\x89MCAP0\r\n" + bytes(100)])
def test_a_recording_that_is_none(in_process: Run, tmp_path: Path, command: str, content: bytes | None) -> None:
    path = tmp_path / "cycle.mcap"
    if content is not None:
        path.write_bytes(content)
    _says(in_process(command, str(path)), 2, str(path))


def test_a_wrong_command_is_a_usage_error() -> None:
    done = _process("dance")
    assert done.returncode == 2 and "dance" in done.stderr and "Traceback" not in done.stderr


def test_a_stop_imports_nothing_that_only_others_need() -> None:
    """An operator in a hurry waits for every import."""
    source = "import sys; from cell.commands import command_line; command_line('stop'); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) & {"cell.client", "cell.daemon", "planning", "perception", "logs", "scipy"} == {
        "cell.client"
    }
