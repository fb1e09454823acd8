"""``cell start`` as a process of its own, as an operator runs it."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from bus.errors import BusError, CellUnreachable
from cell import client
from config.load import load_station
from config.schema import Station

_PATIENCE_S = 90.0


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
