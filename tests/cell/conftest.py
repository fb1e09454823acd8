"""The command line as a user runs it: real processes, a free port, a folder of its own."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from bus.errors import BusError
from cell import client
from config.load import load_station
from config.schema import Station


@pytest.fixture
def options(tmp_path: Path, endpoint: str) -> list[str]:
    """Settings that keep a test's cell away from every other."""
    return ["--set", f"bus.endpoint={endpoint}", "--set", f"recording.folder={tmp_path / 'recordings'}"]


@pytest.fixture
def daemon(options: list[str]) -> Iterator[tuple[subprocess.Popen[str], Station]]:
    """A running ``cell start`` at real-time pace, Stopped, and its station."""
    station = load_station(None, options[1::2])
    process = subprocess.Popen(
        [sys.executable, "-m", "cell", "start", "--no-report", "--set", "sim.pace=1", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        _await_state(station)
        yield process, station
    finally:
        process.terminate()
        process.communicate(timeout=30)


def _await_state(station: Station) -> None:
    give_up_s = time.monotonic() + 60
    while True:
        try:
            with client.connect(station) as connection:
                connection.state()
            return
        except BusError:
            if time.monotonic() > give_up_s:
                raise
            time.sleep(0.2)
