"""``cell start`` as a process of its own, as an operator runs it."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bus.errors import BusError, CellUnreachable
from cell import client
from config.load import load_station
from config.schema import Station

_PATIENCE_S = 90.0
_LONGEST_S = 300.0


@contextmanager
def cell_started(overrides: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    """The daemon's process, once it answers; killed in the end. Raises: CellUnreachable.

    Args:
        overrides: ``key=value`` of the built-in station.
    """
    options = [part for one in overrides for part in ("--set", one)]
    command = [sys.executable, "-m", "cell", "start", "--no-report", *options]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        _await_answer(load_station(None, overrides), process)
        yield process
    finally:
        process.kill()
        process.wait()


def _await_answer(station: Station, process: subprocess.Popen[bytes]) -> None:
    give_up_s = time.monotonic() + _PATIENCE_S
    while True:
        try:
            with client.connect(station) as operator:
                operator.state()
                return
        except BusError as error:
            if process.poll() is not None or time.monotonic() > give_up_s:
                raise CellUnreachable(f"The cell did not start: {error}", "See its own message above.") from error
            time.sleep(0.1)


def recorded_cycle(folder: Path, endpoint: str) -> Path:
    """The recording of one simulated cycle. Raises: CellUnreachable when the cell ended without one."""
    return recorded_cycles(folder, endpoint, 1)[-1]


def recorded_cycles(folder: Path, endpoint: str, count: int, seed: int = 1) -> list[Path]:
    """The recordings of so many simulated cycles. Raises: CellUnreachable when the cell ended without any."""
    settings = (f"recording.folder={folder}", f"bus.endpoint={endpoint}", f"sim.seed={seed}")
    command = [sys.executable, "-m", "cell", "start", "--cycles", str(count), "--json", "--no-report"]
    done = subprocess.run(
        [*command, *(part for setting in settings for part in ("--set", setting))],
        check=False,
        capture_output=True,
        text=True,
        timeout=_LONGEST_S,
    )
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    recordings = [Path(line["recording"]) for line in lines if "recording" in line]
    if not recordings:
        raise CellUnreachable(f"The cell recorded no cycle: {done.stderr.strip()[-500:]}", "See its own message.")
    return recordings
